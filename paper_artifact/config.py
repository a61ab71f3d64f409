"""A run's configuration, typed: every number that can change its result, and nothing else.

`RunConfig` is one run, `LossConfig` what its topology term adds. Paths, thread counts and verbosity are not
here: they cannot change the bits. A run's name is a hash of what differs from the defaults here (`identity`),
so a new field renames no recorded run.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from types import NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from paper_artifact.errors import InputError, real

# Raise this when the default of a field changes (a new field changes none), and note below what it was.
DEFAULTS_VERSION = 1
# What defaults were, {version: {"steps": 2500, "loss.rho": 0.1}}: records of old versions keep their names.
FORMER_DEFAULTS: dict[int, dict[str, Any]] = {}

DEVICES = ("cpu", "cuda", "auto")  # of training
AUTO = "auto"  # as `samples` of the kind "betti"; stored as 0
STEPS_OF_THE_STUDY = 2500
LEAST_SIDE = 22  # pixels of an image: the SSIM window is 11, resampling works at half size
# The largest values that a setting may have: none overflows, and what needs memory asks for it first.
MOST, MOST_SAMPLES, MOST_STEPS, LAST_SEED = 1e6, 10**9, 10**9, 2**63 - 1
DUMP_STEPS = (100, 200, 400, 700, 1000, 1300, 1600, 1900, 2100, 2300, 2400, 2500)  # of these steps
_kinds: Callable[[Any], dict[str, Any]] = cache(get_type_hints)  # of a configuration's fields


def _setting(default: Any, about: str, low: float | None = None, **more: Any) -> Any:
    """Return a field whose metadata say what it is ("help") and which values it takes: at least "low", more
    than "above", at most "high", less than "below", one of "choices"."""
    given = {"help": about, "low": low} | more
    return field(
        default=default, metadata={name: value for name, value in given.items() if value is not None}
    )


def limits(about: Mapping[str, Any]) -> str:
    """Return the range that a field's metadata state as words, "" for none: "at least 0 and below 1"."""
    words = {"above": "more than", "low": "at least", "below": "below", "high": "at most"}
    found = [f"{word} {about[name]:g}" for name, word in words.items() if name in about]
    return " and ".join(found).replace("more than 0", "positive")


def _check_fields(config: Any) -> None:
    """Store each field as its type. Raises InputError for a value of another kind or out of its metadata's
    range."""
    kinds = _kinds(type(config))
    for each in fields(config):
        about, value = each.metadata, _converted(each.name, kinds[each.name], getattr(config, each.name))
        object.__setattr__(config, each.name, value)  # as the frozen dataclass's own __init__ does
        if "choices" in about and value not in about["choices"]:
            raise InputError(f"unknown {each.name} {value!r}; choose one of {', '.join(about['choices'])}")
        if limits(about) and not (
            about.get("above", -math.inf) < value < about.get("below", math.inf)
            and about.get("low", -math.inf) <= value <= about.get("high", math.inf)
        ):
            unit = f" {about['unit']}" if "unit" in about else ""
            raise InputError(f"{each.name} must be {limits(about)}{unit}, got {_brief(value)}")


@dataclass(frozen=True)
class LossConfig:
    """What a condition adds to the photometric loss. Raises InputError for a value out of range.

    Lengths are divided by the ground truth's bounding-box diagonal; for the kind "betti", which knows none,
    by that of the SfM cloud.
    """

    kind: str = _setting(
        "topology",
        "matched persistence (paper §3.3), the control C2 (§3.5), or stated Betti numbers",
        choices=("topology", "repulsion", "betti"),
    )
    rho: float = _setting(
        0.1,
        "norm of the topology gradient ÷ photometric one, at the first active step (§3.4)",
        above=0,
        high=MOST,
    )
    ramp: tuple[float, float] | None = _setting(
        (0.2, 0.5), "fractions of the run between which the weight grows"
    )
    recruitment: bool = _setting(True, "missing targets claim the nearest free bar (L_recruit)")
    noise: float = _setting(0.0, "standard deviation of the noise that only the plan sees (C7)", 0, high=1)
    repulsion_radius: float = _setting(
        4.0, "reach of the control, in median spacings of the target", above=0, high=MOST
    )
    curvature_weighted: bool = _setting(False, "weigh each bar by the curvature at its samples (C4)")
    samples: int = _setting(
        2048, f"M, points of live cloud and target bundle; 0 is {AUTO!r}", 0, high=MOST_SAMPLES
    )
    dimensions: tuple[int, ...] | None = _setting(None, "where the loss acts; None: where targets are")
    bundle_seed: int = _setting(0, "seed of the target bundle's samples", 0, high=LAST_SEED)
    calibration_batches: int = _setting(
        1, "batches whose gradient norms set the weight; paper: one", 1, high=10_000
    )
    refresh_every: int = _setting(
        10, "K, steps between two plans; 0: on demand (`TopologyLoss`)", 0, high=MOST_STEPS
    )
    floor_source: str = _setting(
        "bundle", "whose 6 r_med a significant live bar exceeds", choices=("bundle", "live")
    )
    fallback: str = _setting(
        "detach", "of a pair that fails the Gabriel gate (`alpha.radii`)", choices=("detach", "drop")
    )
    method: str = _setting("fast", "of alpha persistence", choices=("fast", "gudhi"))
    # Of the kind "betti" alone.
    betti: tuple[int, ...] | None = _setting(None, "b0, b1, b2 (components, loops, voids) that samples show")
    guard: float = _setting(0.5, "a wanted bar is longer than this fraction of the live floor", 0, high=MOST)
    suppress: str = _setting(
        "floor",
        "other bars that are pushed to the diagonal: above the floor; all of H1, H2; none",
        choices=("floor", "all", "none"),
    )
    aim: str = _setting(
        "deaths",
        "of wanted bars: deaths beyond theirs by `pull`, of the smoothed or the SfM cloud, clean births",
        choices=("deaths", "smoothed", "cloud", "births", "none"),
    )
    pull: float = _setting(
        2.0, "target of a wanted death beyond itself, in live median spacings", 0, high=MOST
    )

    def __post_init__(self) -> None:
        _check_fields(self)
        if self.samples == 0 and self.kind != "betti":
            raise InputError(
                f"samples={AUTO} belongs to the loss kind 'betti' (conditions T1 to T3); for {self.kind!r} "
                "give the number that `python -m paper_artifact audit` finds"
            )
        if 0 < self.samples < 4:
            raise InputError(f"samples must be at least 4, got {self.samples}")
        _check_betti(self)
        if self.ramp is not None and not (len(self.ramp) == 2 and 0 <= self.ramp[0] < self.ramp[1] <= 1):
            raise InputError(f"ramp must be two fractions 0 <= start < end <= 1, or None, got {self.ramp}")
        if (chosen := self.dimensions) is not None and not (
            chosen and set(chosen) <= {0, 1, 2} and len(set(chosen)) == len(chosen)
        ):
            raise InputError(
                f"dimensions must be some of 0, 1, 2, or None for the significant ones, got {chosen}"
            )


@dataclass(frozen=True)
class AllocationConfig:
    """A prior of the allocation study: where triangles are kept and made (paper App. A).

    Raises InputError for a value out of range. `protection` and `subdivided` are not in the paper; the
    study's values are `paper_artifact.catalogue.PRIOR`, these defaults never change.
    """

    centres: str = _setting(
        "topological", "features', drawn per seed, or no field", choices=("topological", "random", "noise")
    )
    spread: float = _setting(1.0, "s, widens each kernel at constant mass; 3: B4", 1e-6, high=MOST)
    levers: str = _setting(
        "resampling",
        "protect and respawn (B2–B5), or the first triangles (B1)",
        choices=("resampling", "start"),
    )
    simplices: str = _setting("both", "of a feature, whose vertices are centres", choices=("both", "death"))
    protection: float = _setting(1.0, "λ of pruning: pixels + λ · Q.9(pixels) · importance", 0, high=MOST)
    subdivided: float = _setting(0.1, "share of the budget that a resampling subdivides", 0, high=1)
    subdivided_from: float = _setting(0.0, "the least importance that is subdivided", 0, high=1)
    samples: int = _setting(2048, "M, points of the bundle that makes the field", 4, high=MOST_SAMPLES)
    bundle_seed: int = _setting(0, "seed of that bundle's samples", 0, high=LAST_SEED)

    def __post_init__(self) -> None:
        _check_fields(self)


@dataclass(frozen=True)
class GivenConfig:
    """One's own mesh or scene, by content: `scene.given.resolve` puts digests in the place of paths."""

    digest: str = _setting("", "sha256 of the mesh's geometry or the scene's files")
    target: str | None = _setting(None, "of a scene: mesh or bundle.json, in a record its sha256")
    downscale: float = _setting(
        1.0, "of a scene: each photograph is made smaller by this factor", 1, high=10_000
    )
    background: str | None = _setting(None, "of a scene, see `scene.load.load_scene`")
    holdout: str | None = _setting(None, "of a scene, see `scene.load.held_out`")

    def __post_init__(self) -> None:
        _check_fields(self)


@dataclass(frozen=True)
class RunConfig:
    """One training run. Raises InputError for a value out of range."""

    shape: str = field(metadata={"help": "a name of the study, a mesh file or a scene's folder"})
    condition: str = _setting("C0", "a tag of `paper_artifact.catalogue`; `loss` holds what it means")
    seed: int = _setting(0, "of everything random", 0, high=LAST_SEED)
    steps: int = _setting(STEPS_OF_THE_STUDY, "training steps", 1, high=MOST_STEPS)
    budget: int = _setting(1200, "triangles kept by pruning (N)", 1, high=10**7)
    views: int = _setting(48, "rendered around the mesh, every 8th held out", 2, high=10_000)
    size: int = _setting(200, "side of a view", LEAST_SIDE, high=8192, unit="pixels")
    background: str = _setting(
        "white", "of the views; a texture is infinitely far away", choices=("white", "black", "texture")
    )
    batch: int = _setting(4, "views per step", 1, high=10_000)
    vertex_lr: float = _setting(
        1e-2, "learning rate of vertices, / scene radius; of photographs: / `Scene.units`", above=0, high=1
    )
    feature_lr: float = _setting(5e-2, "learning rate of the feature logits", above=0, high=100)
    opacity_lr: float = _setting(5e-2, "learning rate of the opacity logits", above=0, high=100)
    mlp_lr: float = _setting(1e-2, "learning rate of the shading MLP", above=0, high=100)
    final_lr: float = _setting(0.01, "every learning rate decays to this fraction", above=0, high=1)
    initial_ratio: float = _setting(7.5, "initial triangles ÷ budget", above=0, high=10_000)
    resample_every: int = _setting(100, "steps between two resamplings", 1, high=MOST_STEPS)
    split_views: int = _setting(20, "views in which long edges are split", 0, high=10_000)
    split_height: float = _setting(0.2, "longest edge that is not split, ÷ image height", 1e-4, high=10_000)
    dump_steps: tuple[int, ...] = _setting(DUMP_STEPS, "evaluated steps")
    samples: int = _setting(20_000, "surface samples of an evaluation", 4, high=MOST_SAMPLES)
    # What a scene of photographs does to training views and start (`paper_artifact.scene.build`); held-out
    # views and the truth of the evaluation stay clean. D is the mesh's diagonal.
    image_noise: float = _setting(0.0, "standard deviation per pixel and channel, of 1", 0, below=1.0)
    camera_noise: float = _setting(0.0, "standard deviation of a camera's centre, / D", 0, below=0.5)
    cloud_noise: float = _setting(0.0, "standard deviation of the SfM cloud's points, / D", 0, below=0.5)
    cloud_outliers: float = _setting(0.0, "share of the cloud that lies anywhere", 0, below=1.0)
    cloud_missing: float = _setting(0.0, "share of the cloud cut out in three places", 0, below=0.9)
    loss: LossConfig | None = _setting(None, "the topology loss")
    allocation: AllocationConfig | None = _setting(None, "the allocation prior")
    given: GivenConfig | None = _setting(None, "one's own mesh or scene")

    def __post_init__(self) -> None:
        _check_fields(self)
        if any(step < 1 or step > self.steps for step in self.dump_steps):
            raise InputError(f"dump_steps must be a tuple of steps in 1…{self.steps}, got {self.dump_steps}")
        if self.loss is not None and self.loss.refresh_every < 1:
            raise InputError("refresh_every must be at least 1 in a run, got 0")
        if self.loss is not None and self.loss.kind == "betti" and self.loss.betti is None:
            raise InputError(
                f"condition {self.condition} needs the Betti numbers of {self.shape!r}: give "
                "--betti b0,b1,b2, for example --betti 1,2,1 for one component, two loops and one void"
            )


NOISES = ("image_noise", "camera_noise", "cloud_noise", "cloud_outliers", "cloud_missing")
Config = TypeVar("Config", LossConfig, AllocationConfig, GivenConfig, RunConfig)
Part = LossConfig | AllocationConfig | GivenConfig
# fields of a RunConfig that are configurations themselves
PARTS: dict[str, Any] = {"loss": LossConfig, "allocation": AllocationConfig, "given": GivenConfig}


def with_changes(config: Config, changes: Mapping[str, Any]) -> Config:
    """Return `config` with fields replaced. Raises InputError for an unknown name or a value of the wrong
    kind or out of range."""
    kinds = _kinds(type(config))
    unknown = sorted(set(changes) - set(kinds))
    if unknown:
        raise InputError(f"unknown setting {', '.join(unknown)}; choose among {', '.join(kinds)}")
    return replace(config, **changes)


def parse_changes(texts: Iterable[str], option: str) -> dict[str, Any]:
    """Return {name: value} of texts NAME=VALUE; a value is a Python literal, a bare list "1,2", or else text.
    Raises InputError, which names the command-line `option`, for a text without an equals sign."""
    parsed: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise InputError(f"{option} takes NAME=VALUE, got {_brief(text)}")
        try:
            parsed[name.replace("-", "_")] = number = ast.literal_eval(value)
            if isinstance(number, int | float) and "_" in value:  # Python reads 1_0 as 10
                raise TypeError
        except (ValueError, SyntaxError):
            parsed[name.replace("-", "_")] = value
        except (RecursionError, MemoryError, TypeError) as error:
            raise InputError(
                f"{option} {name}: {_brief(value)} is no number, text or list of these; give one"
            ) from error
    return parsed


def config_values(config: Part | RunConfig) -> dict[str, Any]:
    """Return the configuration as a nested dict of all its fields, tuples kept."""
    values = {field.name: getattr(config, field.name) for field in fields(config)}
    return {
        name: config_values(value) if name in PARTS and value is not None else value
        for name, value in values.items()
    }


def config_from(values: Mapping[str, Any], version: int = DEFAULTS_VERSION) -> RunConfig:
    """Return the RunConfig of a dict, also of one that went through JSON (lists for tuples); inverse of
    `config_values`.

    A field that is not there has the default it had in `version`. Raises InputError for an unknown field or
    version.
    """
    given = dict(values) if isinstance(values, Mapping) else None
    parts = {name: given.pop(name, None) for name in PARTS} if given is not None else {}
    if given is None or not all(part is None or isinstance(part, Mapping) for part in parts.values()):
        raise InputError(f"a configuration is settings by name, and so is its loss, got {values!r:.60}")
    if not isinstance(shape := given.pop("shape", ""), str):
        raise InputError(f"a configuration's shape is a name or a path, got {shape!r:.60}")
    run = with_changes(RunConfig(shape), {**_former(version, ""), **given})
    made = {
        name: with_changes(PARTS[name](), {**_former(version, f"{name}."), **part})
        for name, part in parts.items()
        if part is not None
    }
    return replace(run, **made)


def identity(config: RunConfig, version: int = DEFAULTS_VERSION) -> dict[str, Any]:
    """Return what names a run: version, shape, condition, seed and the fields that differ from that version's
    defaults; one's own data by their content, not by what they are called."""
    named = {name: getattr(config, name) for name in ("shape", "condition", "seed")}
    values = {"defaults": version} | _differing(config, config_from({"shape": ""}, version)) | named
    if config.given is not None and config.given.digest:
        del values["shape"]
    for name, kind in PARTS.items():
        values.pop(name, None)
        if (part := getattr(config, name)) is not None:
            values[name] = _differing(part, with_changes(kind(), _former(version, f"{name}.")))
    return values


def _differing(config: Config, base: Config) -> dict[str, Any]:
    pairs = ((field.name, getattr(config, field.name), getattr(base, field.name)) for field in fields(config))
    return {name: value for name, value, default in pairs if value != default}


def _former(version: int, prefix: str) -> dict[str, Any]:
    """Return the defaults of `version` that have changed since, of the fields whose names begin with
    `prefix`."""
    if not isinstance(version, int) or not 1 <= version <= DEFAULTS_VERSION:
        raise InputError(
            f"the defaults' version {version} is unknown to this code, which knows 1 to {DEFAULTS_VERSION}"
        )
    changed: dict[str, Any] = {}
    for later in range(DEFAULTS_VERSION - 1, version - 1, -1):  # the oldest statement that still holds wins
        changed |= FORMER_DEFAULTS.get(later, {})
    own = {name: value for name, value in changed.items() if name.rpartition(".")[0] == prefix.rstrip(".")}
    return {name.removeprefix(prefix): value for name, value in own.items()}


def _converted(name: str, kind: Any, value: Any) -> Any:
    """Return `value` as a field of that type takes it; InputError when it is another kind of thing."""
    value = _plain(value)
    parts = [each for each in get_args(kind) if each is not NoneType]
    wanted = parts[0] if NoneType in get_args(kind) else kind
    if value is None and NoneType in get_args(kind):
        return None
    if name == "betti":  # `_check_betti` says what is wrong with it
        return tuple(value) if isinstance(value, (list, tuple)) else (value,)
    if name == "samples" and value == AUTO:
        return 0
    if get_origin(wanted) is tuple:
        item = get_args(wanted)[0]
        several = tuple(value) if isinstance(value, (list, tuple)) else (value,)
        several = tuple(real(each) if item is float and type(each) is int else each for each in several)
        if all(type(each) is item for each in several):
            return several
    elif wanted is float and type(value) in (int, float):
        if math.isfinite(number := real(value)) or type(value) is float:  # no range has what is not finite
            return number
    elif type(value) is wanted:
        return value
    word = kind.__name__ if isinstance(kind, type) else str(kind)
    raise InputError(f"{name} takes a value of kind {word}, got {_brief(value)}")


def _plain(value: Any) -> Any:
    """Return numbers and arrays of numpy and torch as Python's numbers and lists, all else as it is."""
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value] if isinstance(value, list) else tuple(map(_plain, value))
    return value.tolist() if hasattr(value, "tolist") else value


def _brief(value: Any) -> str:
    """Return a value as a message shows it, shortened."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:60]}… ({len(text)} characters)"


def _check_betti(loss: LossConfig) -> None:
    """Raise InputError unless `betti` is None or three counts, and of a loss that takes them."""
    numbers: Any = loss.betti
    if numbers is None:
        return
    if loss.kind != "betti":
        raise InputError(f"betti belongs to the loss kind 'betti' (T1 to T3), not to {loss.kind!r}")
    words = "betti takes three whole numbers b0,b1,b2 (components, loops, voids)"
    if len(numbers) != 3 or any(type(each) is not int for each in numbers):
        raise InputError(f"{words}, got {_brief(numbers)}")
    if min(numbers) < 0 or numbers[0] == 0:
        raise InputError(f"{words}, none of them negative and b0 at least 1, got {numbers}")
