"""Speed and memory, printed by `python -m paper_artifact bench`; every ratio comes from one process."""
