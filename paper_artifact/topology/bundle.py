"""The target bundle: the significant bars of a ground truth, measured once at the density the loss will see.

Paper §3.1: alpha values shift with spacing, so target and live cloud must have the same number of samples M;
births and deaths are RADII divided by the ground truth's bounding-box diagonal D, and D and the floor are
locked for all live evaluations.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from paper_artifact.alpha.persistence import alpha_persistence
from paper_artifact.errors import InputError, whole
from paper_artifact.files import load_json, write_json
from paper_artifact.randomness import stream
from paper_artifact.sampling import check_arrays, sample_surface
from paper_artifact.topology.floor import (
    MULTIPLIER,
    check_diagonal,
    diagonal_of,
    in_diagonals,
    measurement_floor,
    significant,
    space_points,
)

FORMAT = "paper_artifact target bundle 1"
MOST_SAMPLES = 10**8  # of a cloud whose persistence somebody could wait for, and more


@dataclass(frozen=True, eq=False)
class Bundle:
    """Target bars and what they were measured on. Radii and floor are divided by the diagonal."""

    # of dimensions 0, 1, 2: the significant finite bars (k,2) float64 (birth, death), longest first
    bars: tuple[np.ndarray, ...]
    dimensions: tuple[int, ...]  # where the loss acts
    reasons: tuple[str, ...]  # one sentence for each of dimensions 0, 1, 2
    samples: int  # M, points of the target's sample
    seed: int  # of that sample
    floor: float  # floor_multiplier · r_med(M) / diagonal, dimensionless
    floor_multiplier: float  # the paper's 6
    diagonal: float  # D of the ground truth's bounding box, world units
    shape: str  # a name, for messages
    source: str  # "sha256:…" of the geometry the bars were measured on

    @property
    def spacing(self) -> float:
        """Return r_med(M) / diagonal of the target's sample."""
        return self.floor / self.floor_multiplier

    def require_density(self, samples: int) -> None:
        """Raise InputError unless the loss samples at the density M this bundle was built at (paper §3.1)."""
        if samples != self.samples:
            raise InputError(
                f"the bundle of {self.shape!r} was built at M = {self.samples} but the loss samples "
                f"{samples} points; build the bundle at M = {samples}: alpha values shift with density"
            )

    def save(self, path: Path | str) -> None:
        """Write the bundle as JSON, atomically. Raises InputError when the folder is not writable."""
        write_json(path, self.to_json())

    def to_json(self) -> dict:
        """Return the bundle as a JSON-able dict, for its own file or inside a run record."""
        lists = {"dimensions": list(self.dimensions), "reasons": list(self.reasons)}
        return {"format": FORMAT} | vars(self) | lists | {"bars": [each.tolist() for each in self.bars]}


def build_bundle(
    points: np.ndarray,
    diagonal: float,
    *,
    dimensions: tuple[int, ...] | None = None,
    suppress: tuple[int, ...] = (),
    k: float = MULTIPLIER,
    shape: str = "points",
    seed: int = 0,
    source: str | None = None,
) -> Bundle:
    """Return the bundle of `points` (M,3) float64, a sample of the ground truth with diagonal D, world units.

    dimensions: where the loss acts; None takes every dimension with a significant bar (the torus at M = 2048
    gives H1 alone, because its void is below the floor). suppress: dimensions with no target on purpose,
    where every significant live bar is pushed to the diagonal. k: the floor is k·r_med. Raises InputError
    when a dimension of `dimensions` has no significant bar, when none has, or for bad points.
    """
    points, seed = np.ascontiguousarray(space_points(points, 2, "a bundle")), whole("seed", seed)
    diagonal = check_diagonal(diagonal)
    floor = measurement_floor(points, diagonal, k)
    bars, reasons = [], []
    cloud = in_diagonals(points, diagonal)
    for pairs in alpha_persistence(cloud, as_given=True):
        every = pairs.diagram
        lengths = every[:, 1] - every[:, 0]
        kept = every[significant(every, floor)]
        bars.append(kept[np.lexsort((kept[:, 0], -(kept[:, 1] - kept[:, 0])))])
        reasons.append(_reason(lengths, floor, len(kept), len(points)))
    found = tuple(dimension for dimension, kept in enumerate(bars) if len(kept))
    chosen, suppress = found if dimensions is None else _numbers(dimensions), _numbers(suppress)
    for dimension in chosen:
        if not len(bars[dimension]):
            raise InputError(
                f"{shape!r} has no significant bar in dimension {dimension} at M = {len(points)} "
                f"({reasons[dimension]}); choose another dimension, or a larger M"
            )
    if not chosen and not suppress and dimensions is not None:
        raise InputError("no dimension to act in; name one in dimensions or suppress, or leave both out")
    if not chosen and not suppress:
        raise InputError(f"{shape!r} has no significant bar in any dimension at M = {len(points)}; raise M")
    if refused := sorted({*found} & {*suppress}):
        raise InputError(
            f"dimension {refused[0]} of {shape!r} has a significant target bar and cannot be suppressed; "
            "leave it out"
        )
    roles = dict.fromkeys(suppress, "suppressed on purpose") | dict.fromkeys(chosen, "matched")
    return Bundle(
        bars=tuple(bars),
        dimensions=tuple(sorted(roles)),
        reasons=tuple(f"{roles.get(d, 'not acted on')}: {reason}" for d, reason in enumerate(reasons)),
        samples=len(points),
        seed=seed,
        floor=floor,
        floor_multiplier=float(k),
        diagonal=diagonal,
        shape=shape,
        source=source or fingerprint(points),
    )


def build_from_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    samples: int,
    seed: int = 0,
    *,
    shape: str = "mesh",
    **options: Any,
) -> Bundle:
    """Return the bundle at M = `samples` of a mesh, vertices (V,3) world units and faces (F,3).

    The sample is uniform by area; D is the bounding-box diagonal of the vertices. The draw is a function of
    `seed` and equals the live soup's sampler with opacity 1. Further options: those of `build_bundle`. Raises
    InputError as `build_bundle`, `check_arrays` and `sample_surface` do.
    """
    vertices, faces = check_arrays(vertices, faces, shape)
    diagonal = diagonal_of(np.ptp(vertices, axis=0))
    points, _, _ = sample_surface(vertices, faces, samples, stream(seed, "bundle-samples"))
    return build_bundle(
        points, diagonal, shape=shape, seed=seed, source=fingerprint(vertices, faces), **options
    )


def load_bundle(path: Path | str) -> Bundle:
    """Return the bundle that `Bundle.save` wrote to `path`.

    Raises InputError for a file that is missing, no bundle, or inconsistent.
    """
    try:
        value = load_json(path)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"cannot read the bundle {path}: {error}; build it again") from error
    return bundle_from_json(value, str(path))


def bundle_from_json(value: Mapping, name: str = "bundle") -> Bundle:
    """Return the Bundle of a dict made by `Bundle.to_json`.

    Raises InputError, naming `name`, when it is not a valid one.
    """
    if not isinstance(value, Mapping) or value.get("format") != FORMAT:
        raise InputError(f"{name} is not a target bundle of the format {FORMAT!r}; build it again")
    try:
        bars = tuple(np.asarray(each, dtype=np.float64).reshape(-1, 2) for each in value["bars"])
        bundle = Bundle(
            bars=bars,
            dimensions=tuple(int(d) for d in value["dimensions"]),
            reasons=tuple(str(r) for r in value["reasons"]),
            samples=int(value["samples"]),
            seed=int(value["seed"]),
            floor=float(value["floor"]),
            floor_multiplier=float(value["floor_multiplier"]),
            diagonal=float(value["diagonal"]),
            shape=str(value["shape"]),
            source=str(value["source"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} is damaged ({type(error).__name__}: {error}); build it again") from error
    numbers = np.concatenate(
        [each.ravel() for each in bars] + [[bundle.floor, bundle.floor_multiplier, bundle.diagonal]]
    )
    lengths = np.concatenate([each[:, 1] - each[:, 0] for each in bars]) if bars else np.zeros(0)
    valid = (
        len(bars) == 3
        and len(bundle.reasons) == 3
        and np.isfinite(numbers).all()
        and min(numbers[-3:]) > 0
        and (lengths > bundle.floor).all()
        and 4 <= bundle.samples <= MOST_SAMPLES
        and bundle.dimensions
        and set(bundle.dimensions) <= {0, 1, 2}
        and all(value[name] == each for name, each in bundle.to_json().items())  # none rounded, none a text
    )
    if not valid:
        raise InputError(
            f"{name} is damaged (bars below its own floor, or a number out of range or kind); build it again"
        )
    return bundle


def fingerprint(*arrays: np.ndarray) -> str:
    """Return "sha256:…" of arrays' shapes and little-endian values: what a bundle was measured on."""
    digest = hashlib.sha256()
    for each in arrays:
        each = np.asarray(each)
        kind = "<f8" if each.dtype.kind == "f" else "<i8"
        digest.update(f"{kind}{each.shape}".encode())
        digest.update(np.ascontiguousarray(each, dtype=kind).tobytes())
    return "sha256:" + digest.hexdigest()


def _numbers(dimensions: Any) -> tuple[int, ...]:
    """Return dimensions, one or several, as sorted ints; raise InputError for what is none of 0, 1, 2."""
    plain = dimensions.tolist() if hasattr(dimensions, "tolist") else dimensions
    several = plain if isinstance(plain, Iterable) else (plain,)
    for each in several:
        if not isinstance(each, Integral) or each not in (0, 1, 2):
            raise InputError(
                f"dimension {each!r} does not exist in three-dimensional space; choose among 0, 1 and 2"
            )
    return tuple(sorted({int(each) for each in several}))


def _reason(lengths: np.ndarray, floor: float, kept: int, count: int) -> str:
    below = lengths[lengths <= floor]
    largest_out = f"largest excluded {below.max() / floor:.2f}x the floor" if len(below) else "none excluded"
    if not kept:
        return f"no significant bar at M = {count}, {largest_out}"
    tightest = lengths[lengths > floor].min() / floor
    return f"{kept} significant at M = {count}, tightest {tightest:.2f}x the floor, {largest_out}"
