"""One run from its configuration to its record: scene → soup → training → evaluation → JSON.

What is recorded already is read back, not run again; what was killed resumes from its checkpoint.
"""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Callable

import numpy as np
import torch

from paper_artifact.errors import InputError
from paper_artifact.evaluate.scores import evaluate_soup, make_target, tails
from paper_artifact.evaluate.image import image_scores
from paper_artifact.files import RESULTS
from paper_artifact.mesh import Mesh
from paper_artifact.raster.view import ViewRaster, make_camera
from paper_artifact.record.store import make_record, read_record, record_path, write_record
from paper_artifact.scene.build import SceneConfig, build_scene, mesh_hash, scene_folder
from paper_artifact.scene.find import find_mesh
from paper_artifact.scene.load import Scene, load_scene
from paper_artifact.soup.state import Soup, save_soup
from paper_artifact.train.backend import check_device
from paper_artifact.train.config import RunConfig
from paper_artifact.train.loop import train

SCENES = RESULTS / "scenes"
CHECKPOINTS = RESULTS / "checkpoints"
SOUPS = RESULTS / "soups"


def with_condition(config: RunConfig, mesh: Mesh) -> RunConfig:
    """Return the configuration with everything that its condition adds written out, so that the record's name covers it.

    C0 adds nothing. Raises InputError for an unknown condition.
    """
    if config.condition == "C0":
        return replace(config, topology=())
    from paper_artifact.catalogue import REFRESH_EVERY, protocol_of
    from paper_artifact.catalogue import get_condition

    condition, protocol = asdict(get_condition(config.condition)), asdict(protocol_of(config.shape))
    values = {name: value for name, value in condition.items() if name not in ("name", "description")}
    values |= {
        "samples": protocol["samples"],
        "dimensions": protocol["dimensions"],
        "bundle_seed": protocol["seed"],
        "refresh_every": REFRESH_EVERY,
    }
    values |= dict(config.topology)  # explicit choices win
    return replace(config, topology=tuple(sorted(values.items())))


def make_run_term(config: RunConfig, mesh: Mesh):
    """Return (loss term, bundle) of a configuration that `with_condition` completed; (None, None) for C0, importing nothing."""
    if config.condition == "C0":
        return None, None
    from paper_artifact.topology.bundle import build_from_mesh
    from paper_artifact.catalogue import get_condition
    from paper_artifact.topology.term import make_term

    values = dict(config.topology)
    fields = asdict(get_condition(config.condition))
    condition = replace(
        get_condition(config.condition), **{name: value for name, value in values.items() if name in fields}
    )
    extra = {
        name: value
        for name, value in values.items()
        if name not in fields and name not in ("dimensions", "bundle_seed")
    }
    bundle = build_from_mesh(
        mesh.vertices,
        mesh.faces,
        values["samples"],
        values["bundle_seed"],
        shape=config.shape,
        dimensions=values["dimensions"],
    )
    return make_term(condition, bundle, config.steps, config.seed, **extra), bundle


def render_views(soup: Soup, scene: Scene, views: np.ndarray) -> np.ndarray:
    """Return the soup's images (n,H,W,3) float32 in [0,1] of the scene's views, threshold .5 (evaluation, no randomness)."""
    height, width = scene.images.shape[1:3]
    drawn, view = soup.drawn(), ViewRaster(height, width)
    cameras = [make_camera(scene.world_to_clip[index]) for index in views]
    colours = [view.render(drawn, camera, scene.background).copy() for camera in cameras]
    return np.stack(colours).transpose(0, 2, 3, 1)


def prepare_scene(config: RunConfig, mesh: Mesh, root: Path = SCENES) -> Scene:
    """Build the run's scene under `root`, or take the one that is there, and load it. Seeds share a scene: only training
    differs."""
    scene_config = SceneConfig(views=config.views, size=config.size, background=config.background)
    return load_scene(build_scene(mesh, scene_config, scene_folder(mesh, scene_config, root)))


def run(
    config: RunConfig,
    *,
    mesh: Mesh | None = None,
    results: Path = RESULTS,
    progress: Callable[[int, str], None] | None = None,
    device: str = "auto",
    again: bool = False,
) -> dict:
    """Train and evaluate one configuration, write record and soup, and return the record; a record that exists is returned as it
    is.

    results: folder that gets runs/ (the record), soups/, scenes/, targets/ and checkpoints/. again: run even if recorded.
    Raises InputError for bad input or a folder that is not writable, before any training.
    """
    check_device(device)
    mesh = mesh if mesh is not None else find_mesh(config.shape)
    config = with_condition(config, mesh)
    path = record_path(config, results / "runs")
    if path.is_file() and not again:
        record = read_record(path)
        # Of a mesh file the configuration holds the path only. (Analytic shapes may differ in the last bit between machines.)
        if Path(config.shape).is_file() and record.get("mesh", {}).get("sha256") != mesh_hash(mesh):
            raise InputError(
                f"the record {path} is of another mesh than {config.shape} is now; run with --again to replace it"
            )
        return record
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"cannot write results to {results}: {error.strerror}; choose a folder that you can write to"
        ) from error
    scene = prepare_scene(config, mesh, results / "scenes")
    target = make_target(mesh, config.samples, cache=results / "targets")
    term, bundle = make_run_term(config, mesh)
    checkpoint = results / "checkpoints" / f"{path.stem}-{mesh_hash(mesh)[:8]}.pt"
    cpu = time.process_time()

    def evaluate(soup: Soup, step: int) -> dict:
        return evaluate_soup(
            soup.vertices.detach().numpy(), soup.corner_opacity(), target, config.seed, step
        ) | {"triangles": len(soup)}

    outcome = train(
        scene, config, term=term, evaluate=evaluate, checkpoint=checkpoint, progress=progress, device=device
    )
    holdout = image_scores(render_views(outcome.soup, scene, scene.holdout), scene.images[scene.holdout])
    sections = {
        "images": {
            "psnr": round(holdout["psnr"], 4),
            "ssim": round(holdout["ssim"], 6),
            "holdout_views": len(scene.holdout),
        },
        "soup": {"triangles": len(outcome.soup), "resamplings": outcome.resamplings},
        "mesh": {
            "name": mesh.name,
            "sha256": mesh_hash(mesh),
            "diagonal": mesh.diagonal,
            "betti": mesh.betti,
            "dimension": target.dimension,
            "floor": target.floor,
        },
        "cpu_seconds": round(time.process_time() - cpu, 2),
        "resumed_at": outcome.resumed_at,
    }
    if term is not None:
        sections |= {"topology": term.log, "bundle": bundle.to_json()}
    record = make_record(
        config,
        outcome.dumps,
        tails(outcome.dumps, min(3, len(outcome.dumps))) if outcome.dumps else {},
        outcome.seconds,
        losses={"step": list(range(1, len(outcome.losses) + 1)), "loss": outcome.losses},
        **sections,
    )
    save_soup(results / "soups" / f"{path.stem}.npz", outcome.soup)
    write_record(record, results / "runs")
    checkpoint.unlink(missing_ok=True)
    return record
