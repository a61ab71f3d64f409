"""Audit of one's own mesh: certificate → density staircase → observable class and density → bundle → report (paper §4, §6)."""
