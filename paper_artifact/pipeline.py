"""One run from its configuration to its record: scene → soup → training → evaluation → JSON.

What is recorded already is read back, not run again; what was killed resumes from its checkpoint.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from paper_artifact.config import LEAST_SIDE, NOISES, AllocationConfig, GivenConfig, RunConfig
from paper_artifact.errors import InputError, require_memory
from paper_artifact.evaluate.diagram import require_memory_for
from paper_artifact.evaluate.image import view_scores
from paper_artifact.evaluate.scores import (
    TAIL_DUMPS,
    Target,
    evaluate_alone,
    evaluate_soup,
    make_target,
    tails,
)
from paper_artifact.files import OWN, RESULTS, check_writable
from paper_artifact.frame import SAME, Frame
from paper_artifact.mesh import Mesh, mesh_hash
from paper_artifact.randomness import stream
from paper_artifact.record.form import misfit
from paper_artifact.record.store import (
    check_unedited,
    config_hash,
    make_record,
    read_record,
    record_path,
    recorded_path,
    write_record,
)
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.build import Perturbation, SceneConfig, build_scene, scene_folder
from paper_artifact.scene.folder import scene_digest
from paper_artifact.scene.given import Given, is_own, resolve
from paper_artifact.scene.load import Scene, load_scene
from paper_artifact.scene.subject import within
from paper_artifact.soup.resample import Resampler
from paper_artifact.soup.state import Soup, save_soup
from paper_artifact.topology.bundle import Bundle, build_from_mesh
from paper_artifact.topology.importance import ImportanceField, feature_kernels, importance_field
from paper_artifact.topology.statement import Statement, finished, frame_diagonal
from paper_artifact.topology.term import TopologyTerm, Within, statement_term
from paper_artifact.train.backend import check_device
from paper_artifact.train.loop import train
from paper_artifact.train.state import alone

DENSE = 20_000  # points of the target surface that hold an importance field


def make_run_bundle(config: RunConfig, mesh: Mesh | None) -> Bundle | None:
    """Return what the run's loss acts towards, of the mesh; None for no loss and for stated Betti numbers.
    Raises InputError for a target without a significant bar."""
    loss = config.loss
    if loss is None or loss.kind == "betti":
        return None
    assert mesh is not None
    geometry = mesh.vertices, mesh.faces, loss.samples, loss.bundle_seed
    return build_from_mesh(*geometry, shape=config.shape, dimensions=loss.dimensions)


def make_run_term(
    config: RunConfig,
    bundle: Bundle | None,
    points: np.ndarray | None = None,
    *,
    strict: bool = False,
    tell: Callable[[str], None] | None = None,
    within: Within | None = None,
) -> TopologyTerm | None:
    """Return the loss term of a configuration, None for no loss.

    bundle: the target (`make_run_bundle`). points: for stated Betti numbers, which have none, the SfM cloud
    (P,3), world units. strict, tell, within: see `TopologyTerm`. Raises InputError for a cloud too small or
    flat.
    """
    loss, steps, seed = config.loss, config.steps, config.seed
    if loss is None:
        return None
    if loss.kind == "betti":
        assert points is not None
        return statement_term(loss, points, steps, seed, strict=strict, tell=tell, within=within)
    assert bundle is not None
    return TopologyTerm(loss, bundle, steps, seed)


def make_run_importance(config: RunConfig, allocation: AllocationConfig, mesh: Mesh) -> ImportanceField:
    """Return the importance field of a run's allocation on the target mesh. Random centres (arms B3, B5) are
    drawn on the surface with the run's seed, of the same number, weights and widths. Noise prefers no place:
    each dense sample has a number of its own in [0, 1), drawn with the run's seed."""

    def sample(count: int, generator: np.random.Generator) -> np.ndarray:
        return sample_surface(mesh.vertices, mesh.faces, count, generator)[0]

    draws, dense = stream(config.seed, "allocation-centres"), sample(DENSE, stream(0, "allocation-dense"))
    if allocation.centres == "noise":
        return ImportanceField(dense, draws.random(DENSE))
    points = sample(allocation.samples, stream(allocation.bundle_seed, "bundle-samples"))
    kernels = feature_kernels(points, mesh.diagonal, allocation)
    if allocation.centres == "random":
        kernels = [replace(each, centres=sample(len(each.centres), draws)) for each in kernels]
    return importance_field(kernels, dense)


def make_run_allocation(
    config: RunConfig, mesh: Mesh | None, points: np.ndarray
) -> tuple[Resampler | None, np.ndarray | None]:
    """Return what an allocation gives to the trainer: a resampler, or the importance of the scene's points
    (n,3); (None, None) for a configuration without allocation."""
    allocation = config.allocation
    if allocation is None:
        return None, None
    assert mesh is not None
    importance = make_run_importance(config, allocation, mesh)
    if allocation.levers == "start":
        return None, importance(points)
    return Resampler(config, importance=importance), None


def prepare_scene(config: RunConfig, mesh: Mesh, root: Path) -> Scene:
    """Build the run's scene under `root`, or take the one that is there, and load it. Seeds share a scene."""
    size = 3 * config.views * config.size**2
    require_memory(size, f"{config.views} views of {config.size} pixels a side", "give fewer or smaller ones")
    perturbation = Perturbation(**{name: getattr(config, name) for name in NOISES})
    scene_config = SceneConfig(
        views=config.views, size=config.size, background=config.background, perturbation=perturbation
    )
    return load_scene(build_scene(mesh, scene_config, scene_folder(mesh, scene_config, root)))


@dataclass(frozen=True)
class StudyMesh:
    """A run on a shape of the study: its views are rendered from the mesh."""

    given: Given
    results: ClassVar[Path] = RESULTS  # where a run's results go unless a folder is named

    def scene(self, results: Path) -> Scene:
        """Return the scene that the run trains on, built below `results` where it does not exist."""
        assert self.given.mesh is not None
        return prepare_scene(self.given.config, self.given.mesh, results / "scenes")

    def remarks(self, scene: Scene) -> list[str]:
        """Return what a user should know before the run, a sentence each."""
        return []

    def content(self) -> str:
        """Return a hash of what the run was given, which names its checkpoint."""
        assert self.given.mesh is not None
        return mesh_hash(self.given.mesh)

    def sections(self, scene: Scene, target: Target | None) -> dict[str, Any]:
        """Return the record's sections of ground truth, in the user's units, and photographs."""
        mesh = self.given.mesh
        if mesh is None or target is None:
            return {}
        truth = {"name": mesh.name, "sha256": mesh_hash(mesh), "diagonal": mesh.diagonal, "betti": mesh.betti}
        return {"mesh": truth | {"dimension": target.dimension, "floor": target.floor}}


class OwnMesh(StudyMesh):
    """A run on one's own mesh file; its results are not the study's."""

    results: ClassVar[Path] = OWN


class OwnScene(OwnMesh):
    """A run on one's own photographs, with a target or without."""

    def scene(self, results: Path) -> Scene:
        """Return the scene as the run sees it. Raises InputError for photographs that are too small, and for
        a folder that is not what it was when the run got its name."""
        given, folder = self.given.config.given or GivenConfig(), self.given.folder
        assert folder is not None
        scene = load_scene(
            folder, downscale=given.downscale, background=given.background, holdout=given.holdout
        )
        if scene_digest(folder) != given.digest:
            raise InputError(f"{folder} was saved anew while it was read; start again")
        height, width = scene.images.shape[2:]
        if min(height, width) < LEAST_SIDE:
            raise InputError(
                f"the images of {folder} are {width}×{height} pixels, at least {LEAST_SIDE} a side are "
                "needed; give a smaller --downscale"
            )
        return scene

    def remarks(self, scene: Scene) -> list[str]:
        """Return what a user should know before the run, a sentence each."""
        config, target = self.given.config, self.given.bundle or self.given.mesh
        found, wanted, count = [], round(config.initial_ratio * config.budget), len(scene.points)
        if wanted > count:
            found.append(
                f"the run would start from {wanted} triangles ({config.initial_ratio:g} times the budget of "
                f"{config.budget}), but the SfM cloud has {count} points: it starts from {count}"
            )
        if target is not None:
            ratio = scene.frame.length(target.diagonal) / frame_diagonal(scene.points)
            if not 0.5 <= ratio <= 2:
                found.append(
                    f"the target's diagonal is {ratio:.3g} times the SfM cloud's: bring both to one unit of "
                    "length, or its bars are compared with others"
                )
        return found

    def content(self) -> str:
        """Return a hash of what the run was given, which names its checkpoint."""
        return config_hash(self.given.config)

    def sections(self, scene: Scene, target: Target | None) -> dict[str, Any]:
        """Return the record's sections of ground truth and photographs."""
        given = {
            "views": len(scene.names),
            "holdout": [scene.names[view] for view in scene.holdout],
            "size": list(scene.images.shape[:1:-1]),  # width, height
            "points": len(scene.points),
            "radius": scene.radius,
            "diagonal": frame_diagonal(scene.points),
            "background": scene.background,
        }
        return super().sections(scene, target) | {"scene": given}


def subject_of(config: RunConfig, mesh: Mesh | None = None) -> StudyMesh:
    """Return what a configuration asks for, read and checked, as one of the three kinds of runs; errors as
    `scene.given.resolve`."""
    given = resolve(config, mesh)
    if given.config.given is None:
        return StudyMesh(given)
    return OwnMesh(given) if given.folder is None else OwnScene(given)


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
    """Return the record of one configuration: train, evaluate, write record and soup, or read what exists.

    config.shape: a shape of the study, a mesh file or a scene's folder; the record has the content's digest
    in the place of a path (`scene.given.resolve`). results: folder that gets runs/ (the record), soups/,
    scenes/ and checkpoints/; None: `results_of`. again: run even if recorded. tell: called with
    each remark on stated Betti numbers and on a scene; strict: what contradicts the statement is an
    InputError, of a finished run after its record is written. Raises InputError for bad input, a folder
    that is not writable, or what `check_unedited` refuses, before any training."""
    check_device(device)
    subject = subject_of(config, mesh)
    config, results = subject.given.config, results or subject.results
    if not again and (found := recorded_path(config, results / "runs")) is not None:
        return _uncontradicted(read_record(found), strict)
    require_memory_for(max(part.samples for part in (config, config.loss, config.allocation) if part))
    # before the scene: a loss without a target fails early
    bundle = subject.given.bundle or make_run_bundle(config, subject.given.mesh)
    path = record_path(config, results / "runs")
    check_writable(path)
    check_unedited(path)
    checkpoint = results / "checkpoints" / f"{path.stem}-{subject.content()[:8]}.pt"
    with alone(checkpoint, tell):
        if not again and (found := recorded_path(config, results / "runs")) is not None:  # meanwhile
            return _uncontradicted(read_record(found), strict)
        scene = subject.scene(results)
        if tell is not None:
            for remark in subject.remarks(scene):
                tell(remark)
        mesh, bundle = _in_frame(scene.frame, subject.given.mesh, bundle)
        of_it = within(scene)
        term = make_run_term(config, bundle, scene.points, strict=strict, tell=tell, within=of_it)
        target = None if mesh is None else make_target(mesh, config.samples)
        resampler, importance = make_run_allocation(config, mesh, scene.points)
        cpu = time.process_time()
        state = train(
            scene,
            config,
            term=term,
            evaluate=_evaluator(config, scene, target, of_it),
            checkpoint=checkpoint,
            progress=progress,
            device=device,
            resampler=resampler,
            importance=importance,
            tell=tell,
        )
        kept = save_soup(results / "soups" / f"{path.stem}.npz", state.soup, scene.frame)
        sections = {
            "images": _holdout_section(state.soup, scene),
            "soup": {"triangles": len(state.soup), "resamplings": state.resamplings, "sha256": kept},
            "cpu_seconds": round(time.process_time() - cpu, 2),
            "resumed_at": state.resumed_at,
            **({"warnings": state.warnings} if state.warnings else {}),
            **subject.sections(scene, target),
            **({} if scene.frame == SAME else {"frame": scene.frame.to_json()}),
            **({} if term is None else _term_sections(term)),
        }
        losses: dict[str, list] = {"step": list(range(1, len(state.losses) + 1)), "loss": state.losses}
        scores = tails(state.dumps, min(TAIL_DUMPS, len(state.dumps))) if state.dumps else {}
        record = make_record(config, state.dumps, scores, state.seconds, losses, **sections)
        if state.resumed_at is not None and (place := misfit(record)) is not None:
            raise InputError(
                f"checkpoint {checkpoint} has no {place} as a run leaves it; delete it to start anew"
            )
        write_record(record, results / "runs")
        checkpoint.unlink(missing_ok=True)
        return _uncontradicted(record, strict)


def _in_frame(frame: Frame, mesh: Mesh | None, bundle: Bundle | None) -> tuple[Mesh | None, Bundle | None]:
    """Return the target in the coordinates of the run's frame."""
    if frame != SAME:
        mesh = None if mesh is None else mesh.framed(frame)
        bundle = None if bundle is None else replace(bundle, diagonal=frame.length(bundle.diagonal))
    return mesh, bundle


def _evaluator(
    config: RunConfig, scene: Scene, target: Target | None, of_it: Within | None
) -> Callable[[Soup, int], dict]:
    """Return what makes a dump of (soup, step): against the target, else of the subject alone."""

    def evaluate(soup: Soup, step: int) -> dict:
        corners, opacity = soup.vertices.detach().numpy(), soup.corner_opacity()
        if target is None:
            unit = frame_diagonal(scene.points)
            kept = np.ones(len(soup), bool) if of_it is None else of_it(corners.mean(axis=1))
            corners, opacity = corners[kept], opacity[kept]
            shown = evaluate_alone(corners, opacity, unit, config.samples, config.seed, step)
        else:
            shown = evaluate_soup(corners, opacity, target, config.seed, step)
        return shown | {"triangles": len(soup)}

    return evaluate


def _term_sections(term: TopologyTerm) -> dict[str, Any]:
    """Return the record's sections of the loss: its log, and its statement or bundle."""
    name = "statement" if isinstance(term.target, Statement) else "bundle"
    return {"topology": term.log, name: term.target.to_json()}


def audit_remarks(record: dict, kind: str) -> list[str]:
    """Return what a record says of the stated Betti numbers: its audits' "warnings" or "notes"; a finished
    soup with more features than stated is a warning."""
    audits = [event for event in record.get("topology") or () if event["event"] == "audit"]
    found = [each for event in audits for each in event.get(kind, ())]
    said, dumps = record.get("statement"), record["dumps"]
    if kind == "warnings" and said is not None and dumps:
        found += finished(Statement(tuple(said["betti"]), said["diagonal"]), dumps[-1]["counts"])
    return found


def _uncontradicted(record: dict, strict: bool) -> dict:
    """Return the record. Raises InputError when strict and it contradicts its stated Betti numbers."""
    warnings = audit_remarks(record, "warnings") if strict else []
    if warnings:
        raise InputError(f"strict, and the record holds a warning: {warnings[0]}")
    return record


def results_of(config: RunConfig) -> Path:
    """Return the folder that a run's results go to where none is named: results/ for the study, its
    git-ignored results/own/ for one's own data, which nobody means to publish with the study's records."""
    return OWN if is_own(config) else RESULTS


def _holdout_section(soup: Soup, scene: Scene) -> dict:
    """Return the record's section of the held-out views, or {"holdout_views": 0} where there are none."""
    if not len(scene.holdout):
        return {"holdout_views": 0}
    scores = view_scores(soup, scene, scene.holdout)
    numbers = {"psnr": round(scores["psnr"], 4), "ssim": round(scores["ssim"], 6)}
    return numbers | {"holdout_views": len(scene.holdout)}
