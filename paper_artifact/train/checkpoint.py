"""Checkpoints: all that a run needs to go on to the same bits, written atomically right after a resampling.

Right after a resampling the soup's optimiser is new and the topology plan is due, so neither has to be
stored; the MLP's moments and the term's own state are.
"""

from __future__ import annotations

from pathlib import Path

import torch

from paper_artifact.config import RunConfig, config_values
from paper_artifact.errors import InputError
from paper_artifact.files import atomic_path
from paper_artifact.soup.adam import soup_optimiser
from paper_artifact.soup.state import soup_of
from paper_artifact.train.backend import Backend
from paper_artifact.train.state import TrainState
from paper_artifact.train.term import LossTerm

FORMAT = 3
HISTORY = ("step", "losses", "dumps", "resamplings", "seconds")  # fields of the state, stored as they are


def write_checkpoint(
    path: Path, config: RunConfig, state: TrainState, term: LossTerm, backend: Backend
) -> None:
    """Write the state of a run and of its term, atomically. Raises InputError when the folder is not
    writable."""
    soup = backend.to_host(state.soup)
    saved = {name: getattr(state, name) for name in HISTORY} | {
        "format": FORMAT,
        "config": _text(config),
        "soup": [tensor.detach() for tensor in soup.tensors()],
        "mlp_moments": state.optimiser.mlp_state(),
        "term": term.state(),
    }
    with atomic_path(path) as temporary:
        torch.save(saved, temporary)


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
        saved = torch.load(path, weights_only=True, map_location="cpu")
        version, saved_config = saved["format"], saved["config"]
        history = {name: saved[name] for name in HISTORY}
        soup = soup_of(saved["soup"]).trainable()
        moments, term_state = saved["mlp_moments"], saved["term"]
    except Exception as error:  # torch.load raises many kinds for a damaged file
        raise InputError(
            f"checkpoint {path} is damaged ({type(error).__name__}); delete it to start the run anew"
        ) from error
    if version != FORMAT or saved_config != _text(config):
        raise InputError(
            f"checkpoint {path} belongs to another configuration; delete it to start the run anew"
        )
    soup = backend.to_device(soup)
    state = TrainState(soup=soup, optimiser=soup_optimiser(soup), resumed_at=history["step"], **history)
    state.optimiser.load_mlp_state(moments)
    term.load_state(term_state)
    return state


def _text(config: RunConfig) -> str:
    return repr(sorted(config_values(config).items()))
