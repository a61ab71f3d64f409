"""One run from its configuration to its record: scene → soup → training → evaluation → JSON.

What is recorded already is read back, not run again; what was killed resumes from its checkpoint.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from paper_artifact.config import AllocationConfig, RunConfig
from paper_artifact.errors import InputError
from paper_artifact.evaluate.image import image_scores
from paper_artifact.evaluate.scores import TAIL_DUMPS, evaluate_soup, make_target, tails
from paper_artifact.files import RESULTS, write_failure
from paper_artifact.mesh import Mesh, mesh_hash
from paper_artifact.randomness import stream
from paper_artifact.record.store import make_record, read_record, record_path, recorded_path, write_record
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.build import SceneConfig, build_scene, scene_folder
from paper_artifact.scene.find import find_mesh
from paper_artifact.scene.load import Scene, load_scene
from paper_artifact.soup.allocation import allocating_resampler
from paper_artifact.soup.render import render_views
from paper_artifact.soup.resample import Resampler
from paper_artifact.soup.state import Soup, save_soup
from paper_artifact.train.backend import check_device
from paper_artifact.train.loop import train

if TYPE_CHECKING:
    from paper_artifact.topology.bundle import Bundle
    from paper_artifact.topology.importance import ImportanceField
    from paper_artifact.topology.term import TopologyTerm

DENSE = 20_000  # points of the target surface that hold an importance field


def make_run_term(
    config: RunConfig,
    mesh: Mesh | None,
    points: np.ndarray | None = None,
    *,
    strict: bool = False,
    tell: Callable[[str], None] | None = None,
) -> tuple[TopologyTerm | None, Bundle | None]:
    """Return (loss term, target bundle) of a configuration; (None, None), without any import, for no loss.

    A loss in words has no bundle and needs no mesh, but the SfM cloud's `points` (P,3), world units. strict,
    tell: see `TopologyTerm`. Raises InputError for a bundle without a bar, or a cloud too small or flat.
    """
    if config.loss is None:
        return None, None
    from paper_artifact.topology.term import TopologyTerm

    loss = config.loss
    if loss.kind == "betti":
        from paper_artifact.topology.words import words_term

        assert points is not None
        return words_term(loss, points, config.steps, config.seed, strict=strict, tell=tell), None
    from paper_artifact.topology.bundle import build_from_mesh

    assert mesh is not None
    bundle = build_from_mesh(
        mesh.vertices,
        mesh.faces,
        loss.samples,
        loss.bundle_seed,
        shape=config.shape,
        dimensions=loss.dimensions,
    )
    return TopologyTerm(loss, bundle, config.steps, config.seed), bundle


def make_run_importance(config: RunConfig, allocation: AllocationConfig, mesh: Mesh) -> ImportanceField:
    """Return the importance field of a run's allocation on the target mesh.

    Random centres are drawn on the surface with the run's seed, of the same number, weights and widths (arms
    B3, B5).
    """
    from paper_artifact.topology.importance import feature_kernels, importance_field

    def sample(count: int, generator: np.random.Generator) -> np.ndarray:
        return sample_surface(mesh.vertices, mesh.faces, count, generator)[0]

    points = sample(allocation.samples, stream(allocation.bundle_seed, "bundle-samples"))
    kernels = feature_kernels(points, mesh.diagonal, allocation.spread)
    if allocation.centres == "random":
        draws = stream(config.seed, "allocation-centres")
        kernels = [each.moved(sample(len(each.centres), draws)) for each in kernels]
    return importance_field(kernels, sample(DENSE, stream(0, "allocation-dense")))


def make_run_allocation(
    config: RunConfig, mesh: Mesh, points: np.ndarray
) -> tuple[Resampler | None, np.ndarray | None]:
    """Return what an allocation gives to the trainer: a resampler, or the importance of the scene's points
    (n,3).

    (None, None), without any import, for a configuration without allocation.
    """
    allocation = config.allocation
    if allocation is None:
        return None, None
    importance = make_run_importance(config, allocation, mesh)
    if allocation.levers == "start":
        return None, importance(points)
    return allocating_resampler(config, allocation, importance), None


def prepare_scene(config: RunConfig, mesh: Mesh, root: Path) -> Scene:
    """Build the run's scene under `root`, or take the one that is there, and load it. Seeds share a scene."""
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
    strict: bool = False,
    tell: Callable[[str], None] | None = None,
) -> dict:
    """Return the record of one configuration: train, evaluate, write record and soup, or read what is there.

    results: folder that gets runs/ (the record), soups/, scenes/, targets/ and checkpoints/. again: run even
    if recorded. tell: called with each remark of a loss in words; strict: what contradicts its words is an
    InputError. Raises InputError for bad input or a folder that is not writable, before any training.
    """
    check_device(device)
    mesh = mesh if mesh is not None else find_mesh(config.shape)
    if not again and (recorded := recorded_path(config, results / "runs")) is not None:
        return _matching(read_record(recorded), recorded, config, mesh)
    in_words = config.loss is not None and config.loss.kind == "betti"
    if not in_words:  # before the scene: a loss without a target is told at once
        term, bundle = make_run_term(config, mesh)
    path = record_path(config, results / "runs")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise write_failure(f"results to {results}", error) from error
    scene = prepare_scene(config, mesh, results / "scenes")
    if in_words:  # from the scene: the mesh is for the evaluation alone
        term, bundle = make_run_term(config, None, scene.points, strict=strict, tell=tell)
    target = make_target(mesh, config.samples, cache=results / "targets")
    resampler, importance = make_run_allocation(config, mesh, scene.points)
    checkpoint = results / "checkpoints" / f"{path.stem}-{mesh_hash(mesh)[:8]}.pt"
    cpu = time.process_time()

    def evaluate(soup: Soup, step: int) -> dict:
        corners, opacity = soup.vertices.detach().numpy(), soup.corner_opacity()
        return evaluate_soup(corners, opacity, target, config.seed, step) | {"triangles": len(soup)}

    state = train(
        scene,
        config,
        term=term,
        evaluate=evaluate,
        checkpoint=checkpoint,
        progress=progress,
        device=device,
        resampler=resampler,
        importance=importance,
    )
    holdout = image_scores(render_views(state.soup, scene, scene.holdout), scene.colours(scene.holdout))
    sections: dict[str, Any] = {
        "images": {
            "psnr": round(holdout["psnr"], 4),
            "ssim": round(holdout["ssim"], 6),
            "holdout_views": len(scene.holdout),
        },
        "soup": {"triangles": len(state.soup), "resamplings": state.resamplings},
        "mesh": {
            "name": mesh.name,
            "sha256": mesh_hash(mesh),
            "diagonal": mesh.diagonal,
            "betti": mesh.betti,
            "dimension": target.dimension,
            "floor": target.floor,
        },
        "cpu_seconds": round(time.process_time() - cpu, 2),
        "resumed_at": state.resumed_at,
    }
    if term is not None:
        name = "statement" if bundle is None else "bundle"
        sections |= {"topology": term.log, name: term.target.to_json()}
    losses: dict[str, list] = {"step": list(range(1, len(state.losses) + 1)), "loss": state.losses}
    scores = tails(state.dumps, min(TAIL_DUMPS, len(state.dumps))) if state.dumps else {}
    record = make_record(config, state.dumps, scores, state.seconds, losses, **sections)
    save_soup(results / "soups" / f"{path.stem}.npz", state.soup)
    write_record(record, results / "runs")
    checkpoint.unlink(missing_ok=True)
    return record


def _matching(record: dict, path: Path, config: RunConfig, mesh: Mesh) -> dict:
    """Return the record. Raises InputError when it is of another mesh (a config holds a path)."""
    # Analytic shapes may differ in the last bit between machines, so only files are compared.
    if Path(config.shape).is_file() and record.get("mesh", {}).get("sha256") != mesh_hash(mesh):
        raise InputError(
            f"the record {path} is of another mesh than {config.shape} is now; run with --again to replace it"
        )
    return record
