"""The study's conditions as data (paper §3.5 and §4). Tags keep the paper's numbering."""

from __future__ import annotations

from dataclasses import dataclass

from paper_artifact.errors import InputError


@dataclass(frozen=True)
class Condition:
    """What a run adds to the photometric loss.

    kind: "none", "topology" or "repulsion"; rho: gradient-norm ratio at the first active step; ramp: fractions of the run
    between which λ grows from 0 to its peak, None for no ramp; recruitment: the paper's L_recruit; noise: standard deviation of
    the noise the plan sees, as a fraction of the diagonal; repulsion_radius: in median spacings of the target;
    curvature_weighted: see `curvature`.
    """

    name: str
    kind: str
    description: str
    rho: float = 0.1
    ramp: tuple[float, float] | None = (0.2, 0.5)
    recruitment: bool = True
    noise: float = 0.0
    repulsion_radius: float = 4.0
    curvature_weighted: bool = False


CONDITIONS = {
    each.name: each
    for each in (
        Condition("C0", "none", "photometric loss only; nothing of the topology package is used"),
        Condition("C1", "topology", "matched persistence loss with recruitment"),
        Condition("C2", "repulsion", "norm-matched control: short-range repulsion of the same samples, same rho"),
        Condition("C2g", "repulsion", "C2 with half the radius", repulsion_radius=2.0),
        Condition("C3", "topology", "C1 without the ramp", ramp=None),
        Condition(
            "C4",
            "topology",
            "C1 with curvature-weighted terms (deferred in the paper; the definition is ours)",
            curvature_weighted=True,
        ),
        Condition("C6", "topology", "C1 without recruitment", recruitment=False),
        Condition("C7", "topology", "C1, the plan sees noise of 0.5 % of the diagonal", noise=0.005),
        Condition("C7h", "topology", "C1, the plan sees noise of 1 % of the diagonal", noise=0.01),
    )
}


def get_condition(name: str) -> Condition:
    """Return the condition of that tag. Raises InputError for an unknown one, C5 among them (it needs the allocation prior)."""
    if name in CONDITIONS:
        return CONDITIONS[name]
    known = ", ".join(CONDITIONS)
    if name == "C5":
        raise InputError(
            f"condition C5 is C1 plus the allocation prior, which is not part of this version; choose one of {known}"
        )
    raise InputError(f"unknown condition {name!r}; choose one of {known}")
