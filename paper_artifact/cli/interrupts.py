"""Ctrl-C: raised where no library swallows it."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType

# Modules: those whose errors are lost, and the start of a process, which would have half of what it needs.
DELAYING = ("importlib._bootstrap", "llvmlite", "weakref", "_weakrefset", "multiprocessing.popen_spawn")


@contextmanager
def listening() -> Iterator[list[int]]:
    """Yield the list of the interrupts that came. In the block each raises KeyboardInterrupt in the main
    thread, a moment later where it might be lost; nothing changes where Ctrl-C is ignored or handled."""
    interrupted: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        interrupted.append(number)
        if _may_be_lost(frame):
            signal.setitimer(signal.ITIMER_REAL, 0.01)
        else:
            raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGINT)
    heard = current_thread() is main_thread() and before in (signal.SIG_DFL, signal.default_int_handler)
    try:
        if heard:
            signal.signal(signal.SIGINT, interrupt)
            signal.signal(signal.SIGALRM, interrupt)
        yield interrupted
    finally:
        if heard:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.signal(signal.SIGINT, before)


def _may_be_lost(frame: FrameType | None) -> bool:
    """Return whether libraries may swallow what is raised in the frame: it, or one that called it, imports a
    module, is llvmlite's or a weak reference's (which C calls back) or a __del__, or starts a process."""
    while frame is not None:
        name = str(frame.f_globals.get("__name__"))
        if name.startswith(DELAYING) or frame.f_code.co_name == "__del__":
            return True
        frame = frame.f_back
    return False
