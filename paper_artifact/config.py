"""A run's configuration, typed: every number that can change its result, and nothing else.

`RunConfig` is one run, `LossConfig` what its topology term adds. Paths, thread counts and verbosity are not
here: they cannot change the bits. A run's name is a hash of what differs from the defaults here (`identity`),
so a new field renames no recorded run.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar, get_type_hints

from paper_artifact.errors import InputError

# Raise this when the default of a field changes (a new field changes none), and note below what it was.
DEFAULTS_VERSION = 1
# What defaults were in older versions, {version: {"steps": 2500, "loss.rho": 0.1}}, so that records of those
# versions keep their names.
FORMER_DEFAULTS: dict[int, dict[str, Any]] = {}

KINDS = ("topology", "repulsion", "betti")
SUPPRESS = ("floor", "all", "none")
AIMS = ("deaths", "smoothed", "births", "none")
BACKGROUNDS = ("white", "black", "texture")
AUTO = "auto"  # as `samples` of the kind "betti"; stored as 0
CENTRES = ("topological", "random")
LEVERS = ("resampling", "start")
FLOOR_SOURCES = ("bundle", "live")
FALLBACKS = ("detach", "drop", "subgradient", "denser")
METHODS = ("fast", "gudhi")
STEPS_OF_THE_STUDY = 2500
DUMP_STEPS = (100, 200, 400, 700, 1000, 1300, 1600, 1900, 2100, 2300, 2400, 2500)  # of these steps


@dataclass(frozen=True)
class LossConfig:
    """What a condition adds to the photometric loss. Raises InputError for a value out of range.

    Lengths are divided by the ground truth's bounding-box diagonal; for the kind "betti", which knows none,
    by that of the SfM cloud.
    """

    # "topology": matched persistence (paper §3.3); "repulsion": the control C2 (§3.5); "betti": Betti numbers
    # instead of a target diagram (`paper_artifact.topology.betti`)
    kind: str = "topology"
    rho: float = (
        0.1  # weighted topology gradient ÷ photometric gradient, norms at the first active step (§3.4)
    )
    ramp: tuple[float, float] | None = (0.2, 0.5)  # fractions of the run between which λ grows; None: at once
    recruitment: bool = True  # the paper's L_recruit: missing targets claim the nearest unmatched bar
    noise: float = 0.0  # standard deviation of the noise that only the plan sees (C7)
    repulsion_radius: float = 4.0  # reach of the control, in median spacings of the target
    curvature_weighted: bool = False  # weigh each bar by the curvature at its samples (C4; our definition)
    samples: int = 2048  # M: points of the live cloud and of the target bundle; 0 ("auto"): see AUTO
    dimensions: tuple[int, ...] | None = None  # where the loss acts; None: all with a significant target bar
    bundle_seed: int = 0  # of the target bundle's samples
    calibration_batches: int = 1  # batches whose gradient norms are averaged when λ is set; paper: one
    refresh_every: int = 10  # K: steps between two plans; 0 only for `TopologyLoss`: a plan is made on demand
    floor_source: str = "bundle"  # whose 6 r_med decides which live bars are significant: "bundle" or "live"
    fallback: str = "detach"  # for a pair that fails the Gabriel gate, see `paper_artifact.alpha.gabriel`
    method: str = "fast"  # alpha persistence by our kernels ("fast") or by gudhi (the oracle)
    # Of the kind "betti" alone.
    betti: tuple[int, ...] | None = None  # b0, b1, b2 as the samples show them: components, loops, voids
    guard: float = 0.5  # a bar shorter than this fraction of the live floor is not taken for a wanted one
    # pushed to the diagonal beyond the wanted bars: "floor" what exceeds the live floor; "all" in H1 and H2;
    # "none" nothing
    suppress: str = "floor"
    # what wanted bars are pulled to: "deaths" beyond their own by `pull`; "smoothed" to no less than those of
    # the smoothed cloud; "births" to what a clean sample has; "none" not at all
    aim: str = "deaths"
    pull: float = 2.0  # how far beyond a wanted bar's death its target lies, in live median spacings

    def __post_init__(self) -> None:
        _one_of("loss kind", self.kind, KINDS)
        _one_of("suppress rule", self.suppress, SUPPRESS)
        _one_of("aim", self.aim, AIMS)
        _one_of("floor_source", self.floor_source, FLOOR_SOURCES)
        _one_of("Gabriel fallback", self.fallback, FALLBACKS)
        _one_of("persistence method", self.method, METHODS)
        for name in ("rho", "repulsion_radius"):
            _positive(self, name)
        for name in ("noise", "guard", "pull"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError(f"{name} must not be negative, got {getattr(self, name)}")
        if self.samples == 0 and self.kind != "betti":
            raise InputError(
                f"samples={AUTO} belongs to the loss kind 'betti' (conditions T1, T2); for {self.kind!r} "
                "give the number that `python -m paper_artifact audit` finds"
            )
        lowest = {"samples": 4, "bundle_seed": 0, "calibration_batches": 1, "refresh_every": 0}
        for name, least in lowest.items():
            if name != "samples" or self.samples != 0:
                _at_least(self, name, least)
        _check_betti(self)
        if self.ramp is not None and not (len(self.ramp) == 2 and 0 <= self.ramp[0] < self.ramp[1] <= 1):
            raise InputError(f"ramp must be two fractions 0 <= start < end <= 1, or None, got {self.ramp}")
        if self.dimensions is not None and not (self.dimensions and set(self.dimensions) <= {0, 1, 2}):
            raise InputError(
                f"dimensions must be some of 0, 1, 2, or None for the significant ones, got {self.dimensions}"
            )


@dataclass(frozen=True)
class AllocationConfig:
    """A prior of the allocation study: where triangles are kept and made (paper App. A).

    Raises InputError for a value out of range. `protection` and `subdivided` are not in the paper; the values
    of the study stand in `paper_artifact.catalogue.PRIOR`, these defaults never change.
    """

    centres: str = "topological"  # at birth and death vertices; "random": drawn on the surface per seed
    spread: float = 1.0  # s: widens each kernel at constant mass; 1 concentrated (B2), 3 spread (B4)
    levers: str = "resampling"  # protect and respawn (B2–B5); "start": only the first triangles (B1)
    protection: float = 1.0  # λ of the prune order: visible pixels + λ · Q.9(visible pixels) · importance
    subdivided: float = 0.1  # share of the budget that is subdivided at a resampling, most important first
    samples: int = 2048  # M of the target bundle whose features make the field
    bundle_seed: int = 0  # of that bundle's samples

    def __post_init__(self) -> None:
        _one_of("allocation centres", self.centres, CENTRES)
        _one_of("allocation levers", self.levers, LEVERS)
        _positive(self, "spread")
        if not 0 <= self.protection < math.inf:
            raise InputError(f"protection must not be negative, got {self.protection}")
        if not 0 <= self.subdivided <= 1:
            raise InputError(f"subdivided must be a share from 0 to 1, got {self.subdivided}")
        for name, least in {"samples": 4, "bundle_seed": 0}.items():
            _at_least(self, name, least)


# What a run's scene may suffer, and the value that each must stay below.
NOISES = {
    "image_noise": 1.0,
    "camera_noise": 0.5,
    "cloud_noise": 0.5,
    "cloud_outliers": 1.0,
    "cloud_missing": 0.9,
}


@dataclass(frozen=True)
class GivenConfig:
    """One's own mesh or scene, by content: `scene.given.resolve` puts digests in the place of paths."""

    digest: str = ""  # sha256 (hex) of the mesh's geometry or the scene's files; "" before they were read
    target: str | None = None  # of a scene: mesh or bundle.json; in a record the sha256 of its content
    downscale: float = 1.0  # of a scene: every photograph is made smaller by this factor
    background: str | None = None  # of a scene: see `scene.load.load_scene`; None: its own, else white
    holdout: str | None = None  # of a scene: see `scene.holdout.held_out`; None: the scene's own rule

    def __post_init__(self) -> None:
        if not 1 <= self.downscale < math.inf:
            raise InputError(f"downscale must be at least 1 (2 halves the width), got {self.downscale}")


@dataclass(frozen=True)
class RunConfig:
    """One training run. Raises InputError for a value out of range."""

    shape: str  # an analytic shape, the key of an external mesh, a mesh file or a scene's folder
    condition: str = "C0"  # a tag of `paper_artifact.catalogue`; what it means stands in `loss`
    seed: int = 0  # of everything random
    steps: int = STEPS_OF_THE_STUDY
    budget: int = 1200  # N: triangles kept by pruning
    views: int = 48  # rendered around the mesh, every 8th held out
    size: int = 200  # of a view, pixels
    background: str = "white"  # "black", or "texture": a patterned surrounding, infinitely far away
    batch: int = 4  # views per step
    vertex_lr: float = 1e-2  # learning rate of the vertices, per unit of scene radius (world units)
    feature_lr: float = 5e-2  # of the feature logits
    opacity_lr: float = 5e-2  # of the opacity logits
    mlp_lr: float = 1e-2  # of the shading MLP's weights
    final_lr: float = 0.01  # every learning rate decays to this fraction
    initial_ratio: float = 7.5  # initial triangles ÷ budget; the first resampling prunes to the budget
    resample_every: int = 100  # steps
    split_views: int = 20  # views in which long edges are split
    split_height: float = 0.2  # an edge longer than this fraction of the image height is split
    dump_steps: tuple[int, ...] = DUMP_STEPS  # that are evaluated, after their resampling
    samples: int = 20_000  # surface samples of an evaluation
    # What a scene of photographs does to training views and start (`paper_artifact.scene.perturb`); held-out
    # views and the truth of the evaluation stay clean. D is the mesh's diagonal.
    image_noise: float = 0.0  # standard deviation per pixel and channel, colours in [0,1]
    camera_noise: float = 0.0  # standard deviation per axis of a camera's centre, / D
    cloud_noise: float = 0.0  # standard deviation per axis of a point of the SfM cloud, / D
    cloud_outliers: float = 0.0  # share of the cloud's points that lie anywhere
    cloud_missing: float = 0.0  # share of the cloud's points that is cut out, in three places
    loss: LossConfig | None = None  # None: photometric loss only (C0)
    allocation: AllocationConfig | None = None  # None: DiffSoup's own resampling
    given: GivenConfig | None = None  # one's own mesh or scene; None: a shape of the study

    def __post_init__(self) -> None:
        lowest = {
            "steps": 1,
            "budget": 1,
            "views": 2,
            "batch": 1,
            "resample_every": 1,
            "split_views": 0,
            "samples": 4,
            "seed": 0,
        }
        for name, least in lowest.items():
            _at_least(self, name, least)
        if self.size < 22:
            raise InputError(
                "size must be at least 22 pixels (the SSIM window is 11, resampling works at half size), "
                f"got {self.size}"
            )
        for name in (
            "vertex_lr",
            "feature_lr",
            "opacity_lr",
            "mlp_lr",
            "final_lr",
            "initial_ratio",
            "split_height",
        ):
            _positive(self, name)
        _one_of("background", self.background, BACKGROUNDS)
        for name, beyond in NOISES.items():
            if not 0 <= getattr(self, name) < beyond:
                raise InputError(f"{name} must be at least 0 and below {beyond:g}, got {getattr(self, name)}")
        whole = isinstance(self.dump_steps, tuple) and all(isinstance(step, int) for step in self.dump_steps)
        if not whole or any(step < 1 or step > self.steps for step in self.dump_steps):
            raise InputError(f"dump_steps must be a tuple of steps in 1…{self.steps}, got {self.dump_steps}")
        if self.loss is not None and self.loss.refresh_every < 1:
            raise InputError("refresh_every must be at least 1 in a run, got 0")
        if self.loss is not None and self.loss.kind == "betti" and self.loss.betti is None:
            raise InputError(
                f"condition {self.condition} needs the Betti numbers of {self.shape!r} in words: give "
                "--betti b0,b1,b2, for example --betti 1,2,1 for one component, two loops and one void"
            )


Config = TypeVar("Config", LossConfig, AllocationConfig, GivenConfig, RunConfig)
Part = LossConfig | AllocationConfig | GivenConfig
# fields of a RunConfig that are configurations themselves
PARTS: dict[str, Any] = {"loss": LossConfig, "allocation": AllocationConfig, "given": GivenConfig}


def with_changes(config: Config, changes: Mapping[str, Any]) -> Config:
    """Return `config` with fields replaced. Raises InputError for an unknown name or a value of the wrong
    kind or out of range."""
    kinds = get_type_hints(type(config))
    unknown = sorted(set(changes) - set(kinds))
    if unknown:
        raise InputError(f"unknown setting {', '.join(unknown)}; choose among {', '.join(kinds)}")
    return replace(config, **{name: _converted(name, kinds[name], value) for name, value in changes.items()})


def parse_changes(texts: Iterable[str], option: str) -> dict[str, Any]:
    """Return {name: value} of texts NAME=VALUE; a value is a Python literal, a bare list "1,2", or else text.

    option: the command-line option, for the message of the InputError that a text without an equals sign
    raises.
    """
    parsed: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise InputError(f"{option} takes NAME=VALUE, got {text!r}")
        try:
            parsed[name.replace("-", "_")] = ast.literal_eval(value)
        except (ValueError, SyntaxError):
            parsed[name.replace("-", "_")] = value
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
    run = with_changes(RunConfig(given.pop("shape", "")), {**_former(version, ""), **given})
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
    text = str(kind)
    if isinstance(value, list):
        value = tuple(value)
    if name == "samples" and value == AUTO:
        value = 0
    if name == "betti" and value is not None:
        return value if isinstance(value, tuple) else (value,)  # `_check_betti` says what is wrong with it
    if "tuple" in text and isinstance(value, int) and not isinstance(value, bool):
        value = (value,)
    if "float" in text and "tuple" not in text and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if "tuple[float" in text and isinstance(value, tuple):
        value = tuple(float(item) if isinstance(item, int) else item for item in value)
    fits = {
        "int": isinstance(value, int) and not isinstance(value, bool),
        "float": isinstance(value, float) and math.isfinite(value),
        "bool": isinstance(value, bool),
        "str": isinstance(value, str),
    }
    if kind in (int, float, bool, str):
        good = fits[kind.__name__]
    elif text == "str | None":
        good = value is None or isinstance(value, str)
    elif "tuple" in text:
        item = float if "tuple[float" in text else int
        whole = isinstance(value, tuple) and all(type(x) is item for x in value)
        good = whole or (value is None and "None" in text)
    else:
        good = value is None or isinstance(value, tuple(PARTS.values()))
    if not good:
        word = kind.__name__ if kind in (int, float, bool, str) else text
        raise InputError(f"{name} takes a value of kind {word}, got {value!r}")
    return value


def _check_betti(loss: LossConfig) -> None:
    """Raise InputError unless `betti` is None or three counts, and of a loss that takes them."""
    numbers: Any = loss.betti
    if numbers is None:
        return
    if loss.kind != "betti":
        raise InputError(f"betti belongs to the loss kind 'betti' (conditions T1, T2), not to {loss.kind!r}")
    words = "betti takes three whole numbers b0,b1,b2 (components, loops, voids)"
    if not isinstance(numbers, tuple) or not all(type(each) is int for each in numbers) or len(numbers) != 3:
        raise InputError(f"{words}, got {numbers!r}")
    if min(numbers) < 0:
        raise InputError(f"{words}, none of them negative, got {numbers}")
    if numbers[0] == 0:
        raise InputError(f"{words}; b0 counts the components and is at least 1, got {numbers}")


def _at_least(config: Any, name: str, least: int) -> None:
    if getattr(config, name) < least:
        raise InputError(f"{name} must be at least {least}, got {getattr(config, name)}")


def _positive(config: Any, name: str) -> None:
    if not 0 < getattr(config, name) < math.inf:
        raise InputError(f"{name} must be positive and finite, got {getattr(config, name)}")


def _one_of(word: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise InputError(f"unknown {word} {value!r}; choose one of {', '.join(known)}")
