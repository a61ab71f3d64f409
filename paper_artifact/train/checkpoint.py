"""Checkpoints: all that a run needs to go on to the same bits, written atomically right after a resampling.

Right after a resampling the soup's optimisers are new and the topology plan is due, so neither has to be stored; the MLP's
optimiser and the term's own state are.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from paper_artifact.errors import InputError
from paper_artifact.files import atomic_path
from paper_artifact.soup.state import Soup
from paper_artifact.train.config import RunConfig

FORMAT = 1


@dataclass(frozen=True)
class Checkpoint:
    """A run's state after `step` (1-based) and its history so far."""

    step: int
    soup: Soup
    shading_optimiser: dict
    losses: list[float]
    dumps: list[dict]
    resamplings: list[dict]
    seconds: dict[str, float]
    term: dict


def write_checkpoint(
    path: Path,
    config: RunConfig,
    step: int,
    soup: Soup,
    shading_optimiser: dict,
    result,
    seconds: dict[str, float],
    term: dict,
) -> None:
    """Write the state after `step`, atomically. Raises InputError when the folder is not writable."""
    state = {
        "format": FORMAT,
        "config": repr(sorted(asdict(config).items())),
        "step": step,
        "soup": [
            soup.vertices.detach(),
            soup.features.detach(),
            soup.opacity.detach(),
            *(tensor.detach() for tensor in soup.mlp),
        ],
        "shading_optimiser": shading_optimiser,
        "losses": list(result.losses),
        "dumps": list(result.dumps),
        "resamplings": list(result.resamplings),
        "seconds": seconds,
        "term": term,
    }
    with atomic_path(path) as temporary:
        torch.save(state, temporary)


def read_checkpoint(path: Path, config: RunConfig) -> Checkpoint | None:
    """Return the checkpoint at `path`, or None when there is none.

    Raises InputError when the file is damaged or belongs to another configuration.
    """
    if not path.is_file():
        return None
    try:
        state = torch.load(path, weights_only=True, map_location="cpu")
        saved_config, version = state["config"], state["format"]
        tensors = state["soup"]
        saved = Checkpoint(
            int(state["step"]),
            Soup(tensors[0], tensors[1], tensors[2], tuple(tensors[3:])).trainable(),
            *(
                state[name]
                for name in ("shading_optimiser", "losses", "dumps", "resamplings", "seconds", "term")
            ),
        )
    except Exception as error:  # torch.load raises many kinds for a damaged file
        raise InputError(
            f"checkpoint {path} is damaged ({type(error).__name__}); delete it to start the run anew"
        ) from error
    if version != FORMAT or saved_config != repr(sorted(asdict(config).items())):
        raise InputError(
            f"checkpoint {path} belongs to another configuration; delete it to start the run anew"
        )
    return saved
