"""Hand-made run records of the study's configurations, for tests of the reports: a tail per run, smooth
trajectories."""

from __future__ import annotations

from pathlib import Path

from paper_artifact.catalogue import shape_row, study_config
from paper_artifact.record.store import make_record, write_record

BETTI = {
    "sphere": (1, 0, 1),
    "torus": (1, 2, 1),
    "cube": (1, 0, 1),
    "two_spheres": (2, 0, 2),
    "double_torus": (1, 4, 1),
    "pot": (1, 6, 1),
    "bowl_narrow": (1, 0, 0),
    "bowl_wide": (1, 0, 0),
}


def study_record(
    shape: str, condition: str, seed: int, tail: float, chamfer: float = 0.005, counts=None, **changes
) -> dict:
    """Return a finished record whose tail is `tail` in the shape's discriminating dimension and .001 in
    the others; changes: as of `study_config`."""
    config, row = study_config(shape, condition, seed, **changes), shape_row(shape)
    dimension = row.judged
    counts = list(counts or row.features)
    dumps = [
        {
            "step": step,
            "bottleneck": [tail if each == dimension else 0.001 for each in range(3)],
            "counts": counts,
            "counts_at_target_floor": counts,
            "floor": 0.02,
            "chamfer": chamfer,
            "chamfer_sum": 2 * chamfer,
            "hausdorff95": 0.01,
            "triangles": config.budget,
            "bars": [[[0.0, 0.01]], [[0.01, 0.1], [0.02, 0.05]], [[0.02, 0.25], [0.03, 0.04]]],
        }
        for step in config.dump_steps
    ]
    tails = {
        "steps": [2300, 2400, 2500],
        "bottleneck": dumps[-1]["bottleneck"],
        "counts": counts,
        "chamfer": chamfer,
        "hausdorff95": 0.01,
    }
    sections = {
        "images": {"psnr": 30.0, "ssim": 0.95, "holdout_views": 6},
        "soup": {
            "triangles": config.budget,
            "resamplings": [{"step": 100, "before": 9000, "pruned": config.budget, "after": config.budget}],
        },
        "mesh": {
            "name": shape,
            "sha256": "0" * 64,
            "diagonal": 3.4,
            "betti": BETTI.get(shape),
            "dimension": dimension,
            "floor": 0.017,
        },
        "cpu_seconds": 60.0,
        "resumed_at": None,
    }
    if config.loss is not None and config.loss.kind == "topology":
        log = [
            {
                "event": "lambda",
                "step": 500,
                "lambda_peak": 100.0,
                "rho": 0.1,
                "photo_norm": 1.0,
                "topo_norm": 0.001,
            }
        ]
        target, recruited = [[0.02, 0.2], [0.03, 0.1]], int(config.loss.recruitment)
        for step in range(501, 2500, 10):
            bars = [
                {"target": target[0], "live": [0.02, 0.19], "kind": "matched"},
                {
                    "target": target[1],
                    "live": [0.03, 0.05] if recruited else None,
                    "kind": "recruited" if recruited else "unreached",
                },
            ]
            report = {
                "significant": 1,
                "matched": 1,
                "recruited": recruited,
                "diagonal": 0,
                "unreached": 1 - recruited,
                "gabriel_failures": 0,
                "targets": bars,
            }
            log.append(
                {
                    "event": "refresh",
                    "step": step,
                    "floor": 0.06,
                    "live_floor": 0.06,
                    "samples": 2048,
                    "dimensions": {str(dimension): report},
                    "denser_rounds": 0,
                }
            )
        bars = [[], [], []]
        bars[dimension] = target[: row.features[dimension]]
        sections |= {
            "topology": log,
            "bundle": {"bars": bars, "samples": 2048, "floor": 0.06, "dimensions": [dimension]},
        }
    return make_record(
        config,
        dumps,
        tails,
        {"photometric": 30.0, "optimiser": 5.0, "topology": 10.0, "evaluate": 9.0},
        losses={"step": list(range(1, 2501)), "loss": [1 / step for step in range(1, 2501)]},
        **sections,
    )


def write_study(folder: Path, runs: dict[tuple[str, str, int], float]) -> None:
    """Write one record per (shape, condition, seed) with that tail."""
    for (shape, condition, seed), tail in runs.items():
        write_record(study_record(shape, condition, seed, tail), folder)
