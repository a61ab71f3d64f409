"""The studies as data: tables of runs, shapes × conditions × seeds (paper §4 "Protocol"; seeds as the paper's tables have them)."""

from __future__ import annotations

from paper_artifact.errors import InputError
from paper_artifact.train.config import RunConfig, default_config

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
    "table2": ((("bob", "rocker-arm", "spot", "fandisk", "armadillo", "horse", "eight"), ("C0", "C1", "C2"), range(3)),),
    "bowls": ((("bowl_narrow", "bowl_wide"), ("C0", "C1", "C2"), range(3)),),
}


def study_configs(name: str, shapes: list[str] | None = None, conditions: list[str] | None = None,
                  seeds: list[int] | None = None) -> list[RunConfig]:
    """Return the study's runs, seed by seed within each block, so that a sweep cut short leaves whole seeds; the lists restrict it.

    Raises InputError for an unknown study or a restriction that leaves nothing.
    """
    if name not in STUDIES:
        raise InputError(f"unknown study {name!r}; choose one of {', '.join(STUDIES)}")
    configs = [default_config(shape, condition=condition, seed=seed)
               for block_shapes, block_conditions, block_seeds in STUDIES[name] for seed in block_seeds
               for shape in block_shapes for condition in block_conditions
               if (not shapes or shape in shapes) and (not conditions or condition in conditions) and (not seeds or seed in seeds)]
    if not configs:
        raise InputError(f"study {name!r} has no run with shape {shapes}, condition {conditions}, seed {seeds}; see paper_artifact/study/studies.py")
    return configs
