"""Progress bars of the command line, through tqdm."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import tqdm as library


class bar(library.tqdm):
    """A progress bar that stays after its end, but not after an error: none above the sentence that says what
    is wrong."""

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        """Close the bar; wipe it when an error ends the block."""
        if kind is not None:
            self.leave = False
        super().__exit__(kind, error, trace)


@contextmanager
def stage_bar(what: str, quiet: bool) -> Iterator[Callable[[str], None]]:
    """Yield stage(text), which shows what is being done and since when, in a line that vanishes."""
    with bar(disable=quiet, bar_format="{desc} [{elapsed}]", leave=False, desc=what) as line:
        yield lambda text: line.set_description_str(f"{what}: {text}")


@contextmanager
def step_bar(what: str, total: int, quiet: bool) -> Iterator[Any]:
    """Yield a bar of training steps with `progress(step, text)`.

    Up to the first step only the time is shown, as that of preparing: kernels are compiled then. The rate and
    the time left are of the steps that this process takes.
    """
    with bar(total=total, disable=quiet, unit="step", bar_format="{desc} [{elapsed}]") as line:
        line.set_description_str(f"{what}: preparing scene and kernels (compiled once, about a minute)")

        def progress(step: int, text: str) -> None:
            if not line.disable and line.bar_format:
                line.bar_format = None
                line.initial = line.n = line.last_print_n = step
                line.start_t = line.last_print_t = time.time()
            line.set_description(f"{what}: {text}", refresh=False)
            line.update(step - line.n)
            line.seen = True

        line.seen, line.progress = False, progress
        yield line
