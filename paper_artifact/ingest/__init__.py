"""Ingest: raw open shells → one closed, certified surface (paper §4 and suppl. B)."""
