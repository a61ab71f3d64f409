"""Fetch the external meshes of meshes.csv into data_scripts/downloads/: the same as `python -m paper_artifact
fetch`.

The table names repository, commit, path, sha256 and licence of each file; no mesh is part of this project.
"""

from __future__ import annotations

import sys

from paper_artifact.cli import main

if __name__ == "__main__":
    sys.exit(main(["fetch", *sys.argv[1:]]))
