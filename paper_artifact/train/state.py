"""A run's state between two steps (soup, optimiser, history), its learning rates, its checkpoints.

A checkpoint holds all that a run needs to go on to the same bits, written atomically right after a
resampling: there the soup's optimiser is new and the topology plan is due, so neither has to be stored; the
MLP's moments and the term's own state are. The first line of the file is the sha256 of the rest, so that a
bit that flipped on the disk is refused instead of giving another result.
"""

from __future__ import annotations

import fcntl
import hashlib
import io
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from paper_artifact.arithmetic import power
from paper_artifact.config import RunConfig, identity
from paper_artifact.errors import InputError
from paper_artifact.files import plain, write_bytes, write_failure
from paper_artifact.soup.adam import SoupOptimiser
from paper_artifact.soup.state import Soup, soup_fault, soup_of
from paper_artifact.train.backend import Backend

if TYPE_CHECKING:
    from paper_artifact.topology.term import TopologyTerm

# what the optimiser moves → the setting that is its learning rate
RATES = {"vertices": "vertex_lr", "features": "feature_lr", "opacity": "opacity_lr", "mlp": "mlp_lr"}
CHECKED_EVERY = 10  # steps between two looks at features, opacity and MLP


class TrainingError(RuntimeError):
    """The run itself broke (a value that is not finite); the message names step, quantity and what to try."""


@dataclass
class TrainState:
    """What a run is after `step` steps, and what it leaves when it is done."""

    step: int  # steps taken: steps count from 1, 0 is the start
    soup: Soup  # on the backend's device while training, on the CPU at the end
    optimiser: SoupOptimiser  # of the soup's tensors
    resampled: bool = True  # the soup was changed wholesale since the last step, as at the start
    losses: list[float] = field(default_factory=list)  # photometric loss of every step, dimensionless
    dumps: list[dict] = field(default_factory=list)  # evaluations
    resamplings: list[dict] = field(
        default_factory=list
    )  # step, triangles before, after pruning, after splitting
    seconds: dict[str, float] = field(default_factory=dict)  # wall time by stage
    resumed_at: int | None = None  # step of the checkpoint that this run went on from
    warnings: list[str] = field(default_factory=list)  # what went wrong since, a sentence each: `watch.Watch`

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the wall time of the block to `seconds` of the stage."""
        begin = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin

    def replace_soup(self, soup: Soup) -> None:
        """Go on with another soup: a new optimiser, but the MLP's moments stay, since only its tensors may be
        new ones."""
        moments = self.optimiser.mlp_state()
        self.soup, self.optimiser, self.resampled = soup, SoupOptimiser(soup), True
        self.optimiser.load_mlp_state(moments)

    def check(self, loss: float, config: RunConfig) -> None:
        """Raise TrainingError unless this step's photometric loss and the vertices are finite, and at every
        tenth, resampling or last step all other values; the raster skips corners that are not finite, so the
        loss alone would never show it."""
        if not np.isfinite(loss):
            self._broken(f"the loss of step {self.step} is {loss}", config)
        due = {self.step % CHECKED_EVERY, self.step % config.resample_every, config.steps - self.step}
        names = ("vertices", "features", "opacities", *["weights of the shading MLP"] * 6)
        for name, tensor in zip(names, self.soup.tensors(), strict=True):
            if name != "vertices" and 0 not in due:
                return
            if not torch.isfinite(tensor.detach()).all():
                self._broken(f"{name} are not finite after step {self.step}", config)

    def _broken(self, what: str, config: RunConfig) -> None:
        rates = ", ".join(f"{name} {getattr(config, name):g}" for name in RATES.values())
        raise TrainingError(f"{what}; lower the learning rates ({rates}) and run again")


def learning_rates(config: RunConfig, radius: float, step: int) -> dict[str, float]:
    """Return the learning rates at `step` (from 1) by what they move: exponential decay to `final_lr`.

    radius: the scene's, world units, which vertex_lr is per unit of.
    """
    decay = power(config.final_lr, step / config.steps)
    rates = {name: getattr(config, setting) * decay for name, setting in RATES.items()}
    return rates | {"vertices": config.vertex_lr * radius * decay}


FORMAT = 4  # raised whenever the same state would go on to other bits
SEAL = b"paper_artifact checkpoint, sha256 "
HISTORY = ("step", "losses", "dumps", "resamplings", "seconds")  # fields of the state, stored as they are


@contextmanager
def alone(checkpoint: Path, tell: Callable[[str], object] | None = None) -> Iterator[None]:
    """Let no other process of this machine be in this block for the same checkpoint: wait until it has left,
    and say so.

    A killed process is in it no more; its lock file stays until the next one leaves. Raises InputError when
    the folder is not writable.
    """
    path = checkpoint.with_suffix(".lock")
    linked = 0
    while not linked:  # by the one that left
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            lock = os.open(path, os.O_RDWR | os.O_CREAT)
        except OSError as error:
            raise write_failure(path, error) from error
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if tell is not None:
                    tell("another process makes this run; waiting for its record")
                fcntl.flock(lock, fcntl.LOCK_EX)
        linked = os.fstat(lock).st_nlink
        if not linked:
            os.close(lock)
    try:
        yield
    finally:
        if not os.fstat(lock).st_size:  # else somebody's file of that name
            path.unlink(missing_ok=True)
        os.close(lock)


def write_checkpoint(
    path: Path, config: RunConfig, state: TrainState, term: TopologyTerm | None, backend: Backend
) -> None:
    """Write the state of a run and of its term, atomically. Raises InputError when the folder is not
    writable or the disk is full."""
    soup = backend.to_host(state.soup)
    saved = {name: getattr(state, name) for name in HISTORY} | {
        "format": FORMAT,
        "config": _text(config),
        "soup": [tensor.detach() for tensor in soup.tensors()],
        "mlp_moments": state.optimiser.mlp_state(),
        "term": {} if term is None else term.state(),
    }
    content = io.BytesIO()  # a few MB; torch's own writer would tell of a full disk in a way of its own
    torch.save(saved, content)
    write_bytes(path, _seal(content.getvalue()) + content.getvalue())


def resumed_state(
    path: Path | None, config: RunConfig, term: TopologyTerm | None, backend: Backend
) -> TrainState | None:
    """Return the state that the checkpoint holds, its soup on the backend's device; None when there is no
    such file.

    The term takes over its own state. Raises InputError when the file is damaged or belongs to another
    configuration.
    """
    if path is None:
        return None
    try:
        content = io.BytesIO(_unsealed(plain(path).read_bytes()))
        saved = torch.load(content, weights_only=True, map_location="cpu")
        if saved["format"] != FORMAT or saved["config"] != _text(config):
            raise InputError(
                f"checkpoint {path} belongs to another configuration; delete it to start the run anew"
            )
        history = {name: saved[name] for name in HISTORY}
        if not 0 < history["step"] <= config.steps:
            raise ValueError(f"it is of step {history['step']} of {config.steps}")
        if (fault := _history_fault(history) or soup_fault(saved["soup"])) is not None:
            raise ValueError(f"it holds {fault}")
        soup = backend.to_device(soup_of(saved["soup"]).trainable())
        state = TrainState(soup=soup, optimiser=SoupOptimiser(soup), resumed_at=history["step"], **history)
        state.optimiser.load_mlp_state(saved["mlp_moments"])
        if term is not None:
            term.load_state(saved["term"])
    except FileNotFoundError:  # also where an equal run that ended a moment ago removed it
        return None
    except InputError:
        raise
    except Exception as error:  # torch.load raises many kinds for a damaged file
        raise InputError(
            f"checkpoint {path} is damaged ({_short(error)}); delete it to start the run anew"
        ) from error
    return state


def _history_fault(history: dict) -> str | None:
    """Return what a checkpoint's history holds that no run leaves there, None where there is nothing."""
    step, losses, seconds = history["step"], history["losses"], history["seconds"]
    if type(step) is not int or len(losses) != step or any(type(each) is not float for each in losses):
        return f"no {step} losses"
    for name in ("dumps", "resamplings"):
        if any(type(each["step"]) is not int or not 0 < each["step"] <= step for each in history[name]):
            return f"{name} of no step"
    if any(type(each) is not float for each in seconds.values()):
        return "seconds that are no numbers"
    return None


def _seal(content: bytes) -> bytes:
    """Return the first line of a checkpoint that holds `content`."""
    return SEAL + hashlib.sha256(content).hexdigest().encode() + b"\n"


def _unsealed(data: bytes) -> bytes:
    """Return what follows the first line. Raises ValueError when it is not what was written."""
    head = len(_seal(b""))
    if data[:head] != _seal(data[head:]):
        raise ValueError("its digest does not fit: cut off, changed, or of an earlier version")
    return data[head:]


def _text(config: RunConfig) -> str:
    """Return what names the run, as its record's name does: a new field orphans no checkpoint."""
    return repr(sorted(identity(config).items()))


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
