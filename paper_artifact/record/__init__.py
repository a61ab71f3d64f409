"""One JSON per run: written atomically, named by a hash of its config, refused when damaged."""
