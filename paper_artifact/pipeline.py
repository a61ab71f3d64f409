"""One run from its configuration to its record: scene → soup → training → evaluation → JSON.

What is recorded already is read back, not run again; what was killed resumes from its checkpoint.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from paper_artifact.config import LEAST_SIDE, NOISES, AllocationConfig, GivenConfig, RunConfig
from paper_artifact.errors import InputError
from paper_artifact.evaluate.image import view_scores
from paper_artifact.evaluate.scores import (
    TAIL_DUMPS,
    Target,
    evaluate_alone,
    evaluate_soup,
    make_target,
    tails,
)
from paper_artifact.files import OWN, RESULTS, write_failure
from paper_artifact.frame import SAME
from paper_artifact.mesh import Mesh, mesh_hash
from paper_artifact.randomness import stream
from paper_artifact.record.store import (
    config_hash,
    config_of,
    make_record,
    read_record,
    record_path,
    recorded_path,
    write_record,
)
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.build import Perturbation, SceneConfig, build_scene, scene_folder
from paper_artifact.scene.given import is_own, resolve
from paper_artifact.scene.load import Scene, load_scene
from paper_artifact.soup.allocation import allocating_resampler
from paper_artifact.soup.resample import Resampler
from paper_artifact.soup.state import Soup, save_soup
from paper_artifact.topology.bundle import Bundle, build_from_mesh
from paper_artifact.topology.importance import ImportanceField, feature_kernels, importance_field
from paper_artifact.topology.statement import Statement, ended, frame_diagonal
from paper_artifact.topology.term import TopologyTerm
from paper_artifact.topology.words import words_term
from paper_artifact.train.backend import check_device
from paper_artifact.train.loop import train

DENSE = 20_000  # points of the target surface that hold an importance field


def make_run_term(
    config: RunConfig,
    mesh: Mesh | None,
    points: np.ndarray | None = None,
    *,
    bundle: Bundle | None = None,
    strict: bool = False,
    tell: Callable[[str], None] | None = None,
) -> tuple[TopologyTerm | None, Bundle | None]:
    """Return (loss term, target bundle) of a configuration; (None, None) for no loss.

    bundle: a target that is there already, instead of the mesh. A loss in words has no bundle and needs no
    mesh, but the SfM cloud's `points` (P,3), world units. strict, tell: see `TopologyTerm`. Raises
    InputError for a bundle without a bar, or a cloud too small or flat.
    """
    loss = config.loss
    if loss is None:
        return None, None
    if loss.kind == "betti":
        assert points is not None
        return words_term(loss, points, config.steps, config.seed, strict=strict, tell=tell), None
    if bundle is None:
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

    def sample(count: int, generator: np.random.Generator) -> np.ndarray:
        return sample_surface(mesh.vertices, mesh.faces, count, generator)[0]

    points = sample(allocation.samples, stream(allocation.bundle_seed, "bundle-samples"))
    kernels = feature_kernels(points, mesh.diagonal, allocation.spread)
    if allocation.centres == "random":
        draws = stream(config.seed, "allocation-centres")
        kernels = [each.moved(sample(len(each.centres), draws)) for each in kernels]
    return importance_field(kernels, sample(DENSE, stream(0, "allocation-dense")))


def make_run_allocation(
    config: RunConfig, mesh: Mesh | None, points: np.ndarray
) -> tuple[Resampler | None, np.ndarray | None]:
    """Return what an allocation gives to the trainer: a resampler, or the importance of the scene's points
    (n,3).

    (None, None) for a configuration without allocation.
    """
    allocation = config.allocation
    if allocation is None:
        return None, None
    assert mesh is not None
    importance = make_run_importance(config, allocation, mesh)
    if allocation.levers == "start":
        return None, importance(points)
    return allocating_resampler(config, allocation, importance), None


def prepare_scene(config: RunConfig, mesh: Mesh, root: Path) -> Scene:
    """Build the run's scene under `root`, or take the one that is there, and load it. Seeds share a scene."""
    perturbation = Perturbation(**{name: getattr(config, name) for name in NOISES})
    scene_config = SceneConfig(
        views=config.views, size=config.size, background=config.background, perturbation=perturbation
    )
    return load_scene(build_scene(mesh, scene_config, scene_folder(mesh, scene_config, root)))


def given_scene(config: RunConfig, folder: Path) -> Scene:
    """Return the scene in `folder` as a run sees it. Raises InputError for photographs that are too small."""
    given = config.given or GivenConfig()
    scene = load_scene(folder, downscale=given.downscale, background=given.background, holdout=given.holdout)
    height, width = scene.images.shape[2:]
    if min(height, width) < LEAST_SIDE:
        raise InputError(
            f"the images of {folder} are {width}×{height} pixels, at least {LEAST_SIDE} a side are needed; "
            "give a smaller --downscale"
        )
    return scene


def remarks(config: RunConfig, scene: Scene, bundle: Bundle | None) -> list[str]:
    """Return what a user should know before a run on a scene that was given, a sentence each."""
    found, wanted, count = [], round(config.initial_ratio * config.budget), len(scene.points)
    if wanted > count:
        found.append(
            f"the run would start from {wanted} triangles ({config.initial_ratio:g} times the budget of "
            f"{config.budget}), but the SfM cloud has {count} points: it starts from {count}"
        )
    if bundle is not None:
        ratio = scene.frame.length(bundle.diagonal) / frame_diagonal(scene.points)
        if not 0.5 <= ratio <= 2:
            found.append(
                f"the target's diagonal is {ratio:.3g} times the SfM cloud's: bring both to one unit of "
                "length, or its bars are compared with others"
            )
    return found


def run(
    config: RunConfig,
    *,
    mesh: Mesh | None = None,
    results: Path | None = None,
    progress: Callable[[int, str], None] | None = None,
    device: str = "auto",
    again: bool = False,
    strict: bool = False,
    tell: Callable[[str], None] | None = None,
) -> dict:
    """Return the record of one configuration: train, evaluate, write record and soup, or read what is there.

    config.shape: a shape of the study, a mesh file or a scene's folder; the record has the content's digest
    in the place of a path (`scene.given.resolve`). results: folder that gets runs/ (the record), soups/,
    scenes/, targets/ and checkpoints/; None: `results_of`. again: run even if recorded. tell: called with
    each remark of a loss in words and of a scene; strict: what contradicts the words is an InputError. Raises
    InputError for bad input or a folder that is not writable, before any training.
    """
    check_device(device)
    given = resolve(config, mesh)
    config, mesh = given.config, given.mesh
    results = results if results is not None else results_of(config)
    if not again and (recorded := recorded_path(config, results / "runs")) is not None:
        return read_record(recorded)
    in_words = config.loss is not None and config.loss.kind == "betti"
    term, bundle = None, given.bundle
    if not in_words:  # before the scene: a loss without a target is told at once
        term, bundle = make_run_term(config, mesh, bundle=bundle)
    path = record_path(config, results / "runs")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise write_failure(f"results to {results}", error) from error
    if given.folder is not None and config.given is not None:
        scene = given_scene(config, given.folder)
        if tell is not None:
            for remark in remarks(config, scene, bundle):
                tell(remark)
    else:
        assert mesh is not None
        scene = prepare_scene(config, mesh, results / "scenes")
    if in_words:  # from the scene: the mesh is for the evaluation alone
        term, bundle = make_run_term(config, None, scene.points, strict=strict, tell=tell)
    frame, truth = scene.frame, mesh
    if frame != SAME:
        mesh = None if mesh is None else mesh.framed(frame)
        if bundle is not None:
            bundle = replace(bundle, diagonal=frame.length(bundle.diagonal))
            term, _ = make_run_term(config, None, bundle=bundle)
    target = None if mesh is None else make_target(mesh, config.samples, cache=results / "targets")
    resampler, importance = make_run_allocation(config, mesh, scene.points)
    source = mesh_hash(truth) if given.folder is None and truth is not None else config_hash(config)
    checkpoint = results / "checkpoints" / f"{path.stem}-{source[:8]}.pt"
    cpu = time.process_time()

    def evaluate(soup: Soup, step: int) -> dict:
        corners, opacity = soup.vertices.detach().numpy(), soup.corner_opacity()
        if target is None:
            seen = evaluate_alone(
                corners, opacity, frame_diagonal(scene.points), config.samples, config.seed, step
            )
        else:
            seen = evaluate_soup(corners, opacity, target, config.seed, step)
        return seen | {"triangles": len(soup)}

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
    sections: dict[str, Any] = {
        "images": holdout_section(state.soup, scene),
        "soup": {"triangles": len(state.soup), "resamplings": state.resamplings},
        "cpu_seconds": round(time.process_time() - cpu, 2),
        "resumed_at": state.resumed_at,
    }
    if truth is not None and target is not None:
        sections["mesh"] = mesh_section(truth, target)
    if given.folder is not None:
        sections["scene"] = scene_section(scene)
    if frame != SAME:
        sections["frame"] = frame.to_json()
    if term is not None:
        name = "statement" if bundle is None else "bundle"
        sections |= {"topology": term.log, name: term.target.to_json()}
    losses: dict[str, list] = {"step": list(range(1, len(state.losses) + 1)), "loss": state.losses}
    scores = tails(state.dumps, min(TAIL_DUMPS, len(state.dumps))) if state.dumps else {}
    record = make_record(config, state.dumps, scores, state.seconds, losses, **sections)
    save_soup(results / "soups" / f"{path.stem}.npz", state.soup, frame)
    write_record(record, results / "runs")
    checkpoint.unlink(missing_ok=True)
    return record


def audit_remarks(record: dict, kind: str) -> list[str]:
    """Return what a record's audit says of the words that its loss was given: its "warnings" or "notes"."""
    audits = [event for event in record.get("topology") or () if event["event"] == "audit"]
    return [each for event in audits for each in event.get(kind, ())]


def closing_notes(record: dict) -> list[str]:
    """Return `topology.statement.ended` of a record of a loss in words, nothing of another."""
    loss, said = config_of(record).loss, record.get("statement")
    if loss is None or said is None:
        return []
    return ended(Statement(tuple(said["betti"]), said["diagonal"]), record["topology"], loss)


def results_of(config: RunConfig) -> Path:
    """Return the folder that a run's results go to where none is named: results/ for the study, its
    git-ignored results/own/ for one's own data, which nobody means to publish with the study's records."""
    return OWN if is_own(config) else RESULTS


def holdout_section(soup: Soup, scene: Scene) -> dict:
    """Return the record's section of the held-out views, or {"holdout_views": 0} where there are none."""
    if not len(scene.holdout):
        return {"holdout_views": 0}
    scores = view_scores(soup, scene, scene.holdout)
    return {
        "psnr": round(scores["psnr"], 4),
        "ssim": round(scores["ssim"], 6),
        "holdout_views": len(scene.holdout),
    }


def mesh_section(mesh: Mesh, target: Target) -> dict:
    """Return what a record says of the ground truth, in the user's units, and of what it is judged by."""
    return {
        "name": mesh.name,
        "sha256": mesh_hash(mesh),
        "diagonal": mesh.diagonal,
        "betti": mesh.betti,
        "dimension": target.dimension,
        "floor": target.floor,
    }


def scene_section(scene: Scene) -> dict:
    """Return what a record says of a scene that was given."""
    height, width = scene.images.shape[2:]
    return {
        "views": len(scene.names),
        "holdout": [scene.names[view] for view in scene.holdout],
        "size": [width, height],
        "points": len(scene.points),
        "radius": scene.radius,
        "diagonal": frame_diagonal(scene.points),
        "background": scene.background,
    }
