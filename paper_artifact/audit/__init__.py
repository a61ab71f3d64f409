"""Audit of one's own mesh: certificate → staircase → observable, density → bundle → page (paper §4, §6)."""
