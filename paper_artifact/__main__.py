"""`python -m paper_artifact VERB`: see `paper_artifact.cli`."""

from __future__ import annotations

import sys

from paper_artifact.cli import main

if __name__ == "__main__":
    sys.exit(main())
