"""Running one job per view on a fixed number of threads.

Jobs write only their own buffers and results are reduced in view order by the caller, so the number of
threads changes the time and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch

from paper_artifact.errors import InputError

_pool: ThreadPoolExecutor | None = None
_count = 1


def set_thread_count(count: int) -> None:
    """Use `count` >= 1 threads for the CPU kernels from now on (default 1). Raises InputError below 1."""
    global _pool, _count
    if count < 1:
        raise InputError(f"the number of threads must be at least 1, got {count}")
    if _pool is not None:
        _pool.shutdown()
    _pool = ThreadPoolExecutor(count) if count > 1 else None
    _count = count


def thread_count() -> int:
    """Return the number of threads that `run_jobs` uses."""
    return _count


def run_jobs(job: Callable[[int], object], count: int) -> list:
    """Return [job(0), …, job(count - 1)], run on the chosen number of threads. Raises what a job raises."""
    if _pool is None or count == 1:
        return [job(index) for index in range(count)]
    return list(_pool.map(job, range(count)))


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keep torch's own operations on one thread inside the block (also usable as a decorator).

    torch cuts large tensors at other places for other thread counts, and the ends of the pieces round
    differently: bits would depend on the machine. numba's thread layer, too, changes OpenMP's count for torch
    when something asks it how many threads it has.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
