"""Counter-based randomness: a draw is a pure function of named integers, so order and threads cannot matter.

`stream` gives a numpy Generator (Philox) for host-side sampling; the rasterizer's per-fragment draws use the
32-bit hash in `paper_artifact.raster.draws`.
"""

from __future__ import annotations

import zlib

import numpy as np

from paper_artifact.errors import InputError, whole


def stream(seed: int, purpose: str, counter: int = 0) -> np.random.Generator:
    """Return the Generator of (seed, purpose, counter); equal arguments give equal draws on every machine.

    seed and counter are non-negative integers below 2**63; `purpose` names the use ("batch", "samples", ...),
    so two uses of one seed never share draws. Raises InputError for other arguments.
    """
    seed, counter = whole("seed", seed, 0, 2**63 - 1), whole("counter", counter, 0, 2**63 - 1)
    if not isinstance(purpose, str):
        raise InputError(f"a stream's purpose is {purpose!r:.60}; give a text, as stream({seed}, 'samples')")
    key = seed << 32 | zlib.crc32(purpose.encode())
    return np.random.Generator(np.random.Philox(key=key, counter=counter << 128))
