"""The studies as data: tables of runs, shapes × conditions × seeds (paper §4 "Protocol"; seeds as in the
paper's tables)."""

from __future__ import annotations

from paper_artifact.catalogue import study_config
from paper_artifact.config import RunConfig
from paper_artifact.errors import InputError

Block = tuple[tuple[str, ...], tuple[str, ...], range]  # shapes, conditions, seeds

STUDIES: dict[str, tuple[Block, ...]] = {
    "baseline": ((("sphere", "torus", "spot"), ("C0",), range(3)),),
    "table1": (
        (("sphere", "torus"), ("C0", "C1", "C2"), range(5)),
        (("cube", "two_spheres"), ("C0", "C1", "C2"), range(3)),
        (("sphere", "torus"), ("C6",), range(5)),
        (("sphere", "torus"), ("C2g", "C3"), range(5)),
        (("double_torus",), ("C0", "C1", "C2"), range(5)),
        (("sphere", "torus"), ("C7", "C7h"), range(3)),
    ),
    "table2": (
        (
            ("bob", "rocker-arm", "spot", "fandisk", "armadillo", "horse", "eight", "pot"),
            ("C0", "C1", "C2"),
            range(3),
        ),
        (("bob",), ("C3",), range(3)),  # the text of §5.1: no ramp, off the analytic family
    ),
    "bowls": ((("bowl_narrow", "bowl_wide"), ("C0", "C1", "C2"), range(3)),),
}


def study_configs(
    name: str,
    shapes: list[str] | None = None,
    conditions: list[str] | None = None,
    seeds: list[int] | None = None,
) -> list[RunConfig]:
    """Return the study's runs, seed by seed within each block: a sweep cut short leaves whole seeds. The
    lists restrict it.

    Raises InputError for an unknown study, a shape, condition or seed that it lacks, or a restriction that
    leaves nothing.
    """
    if name not in STUDIES:
        raise InputError(f"unknown study {name!r}; choose one of {', '.join(STUDIES)}")
    for word, given, position in (("shape", shapes, 0), ("condition", conditions, 1), ("seed", seeds, 2)):
        known = list(dict.fromkeys(value for block in STUDIES[name] for value in block[position]))
        unknown = [str(value) for value in given or () if value not in known]
        if unknown:
            raise InputError(
                f"study {name!r} has no {word} {', '.join(unknown)}; "
                f"choose among {', '.join(map(str, known))}"
            )
    configs = [
        study_config(shape, condition=condition, seed=seed)
        for block_shapes, block_conditions, block_seeds in STUDIES[name]
        for seed in block_seeds
        for shape in block_shapes
        for condition in block_conditions
        if shape in (shapes or [shape])
        and condition in (conditions or [condition])
        and seed in (seeds or [seed])
    ]
    if not configs:
        raise InputError(
            f"study {name!r} has no run with shape {shapes}, condition {conditions}, seed {seeds} at once; "
            "see paper_artifact/study/studies.py"
        )
    return configs
