"""Checkpoints: all that a run needs to go on to the same bits, written atomically right after a resampling.

Right after a resampling the soup's optimiser is new and the topology plan is due, so neither has to be
stored; the MLP's moments and the term's own state are. The first line of the file is the sha256 of the rest,
so that a bit that flipped on the disk is refused instead of giving another result.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import torch

from paper_artifact.config import RunConfig, config_values
from paper_artifact.errors import InputError
from paper_artifact.files import write_bytes
from paper_artifact.soup.adam import soup_optimiser
from paper_artifact.soup.state import soup_of
from paper_artifact.train.backend import Backend
from paper_artifact.train.state import TrainState
from paper_artifact.train.term import LossTerm

FORMAT = 3
SEAL = b"paper_artifact checkpoint, sha256 "
HISTORY = ("step", "losses", "dumps", "resamplings", "seconds")  # fields of the state, stored as they are


def write_checkpoint(
    path: Path, config: RunConfig, state: TrainState, term: LossTerm, backend: Backend
) -> None:
    """Write the state of a run and of its term, atomically. Raises InputError when the folder is not
    writable or the disk is full."""
    soup = backend.to_host(state.soup)
    saved = {name: getattr(state, name) for name in HISTORY} | {
        "format": FORMAT,
        "config": _text(config),
        "soup": [tensor.detach() for tensor in soup.tensors()],
        "mlp_moments": state.optimiser.mlp_state(),
        "term": term.state(),
    }
    content = io.BytesIO()  # a few MB; torch's own writer would tell of a full disk in a way of its own
    torch.save(saved, content)
    write_bytes(path, _seal(content.getvalue()) + content.getvalue())


def resumed_state(
    path: Path | None, config: RunConfig, term: LossTerm, backend: Backend
) -> TrainState | None:
    """Return the state that the checkpoint holds, its soup on the backend's device; None when there is no
    such file.

    The term takes over its own state. Raises InputError when the file is damaged or belongs to another
    configuration.
    """
    if path is None or not path.is_file():
        return None
    try:
        content = io.BytesIO(_unsealed(path.read_bytes()))
        saved = torch.load(content, weights_only=True, map_location="cpu")
        if saved["format"] != FORMAT or saved["config"] != _text(config):
            raise InputError(
                f"checkpoint {path} belongs to another configuration; delete it to start the run anew"
            )
        history = {name: saved[name] for name in HISTORY}
        soup = backend.to_device(soup_of(saved["soup"]).trainable())
        state = TrainState(soup=soup, optimiser=soup_optimiser(soup), resumed_at=history["step"], **history)
        state.optimiser.load_mlp_state(saved["mlp_moments"])
        term.load_state(saved["term"])
    except InputError:
        raise
    except Exception as error:  # torch.load raises many kinds for a damaged file
        raise InputError(
            f"checkpoint {path} is damaged ({_short(error)}); delete it to start the run anew"
        ) from error
    return state


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
    return repr(sorted(config_values(config).items()))


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
