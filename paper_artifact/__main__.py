"""`python -m paper_artifact VERB`: see `paper_artifact.cli`."""

from __future__ import annotations

import signal
import sys

if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C while modules are loaded ends without a trace
from paper_artifact.cli import main

if __name__ == "__main__":
    sys.exit(main())
