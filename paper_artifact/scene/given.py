"""What a run is made of: a shape of the study, or one's own mesh or scene, which its content names.

A configuration that is asked for may name paths; `resolve` reads them and returns the configuration of the
run, with digests in their place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from paper_artifact.config import NOISES, GivenConfig, LossConfig, RunConfig
from paper_artifact.errors import InputError
from paper_artifact.files import file_digest
from paper_artifact.mesh import Mesh, mesh_hash
from paper_artifact.scene.folder import model_folder, scene_digest, scene_name, scene_root
from paper_artifact.scene.shapes import find_mesh, is_named

if TYPE_CHECKING:
    from paper_artifact.topology.bundle import Bundle

RENDERED = ("views", "size", "background", *NOISES)  # settings of scenes that are made of a mesh
NEEDS_TARGET = ("topology", "repulsion")  # kinds of loss


@dataclass(frozen=True, eq=False)
class Given:
    """A run's configuration and what it was made of."""

    config: RunConfig  # of the run and its record: no path
    mesh: Mesh | None  # the ground truth: the shape, or a scene's target where that is a mesh
    folder: Path | None = None  # of a scene that is there already; None: it is rendered from the mesh
    bundle: Bundle | None = None  # a scene's target where that is a bundle


def is_own(config: RunConfig) -> bool:
    """Return whether a configuration asks for one's own data: a scene, or a mesh file."""
    return config.given is not None or (not is_named(config.shape) and Path(config.shape).exists())


def called(config: RunConfig) -> str:
    """Return what the shape, mesh or scene of a configuration is called, without its path."""
    if is_own(config) and Path(config.shape).is_dir():
        return scene_name(scene_root(config.shape))
    return Path(config.shape).name


def resolve(config: RunConfig, mesh: Mesh | None = None) -> Given:
    """Return what `config` asks for, read and checked.

    mesh: the ground truth where it is at hand, taken as it is. Raises InputError for a shape, mesh, scene or
    target that cannot be had, and for a loss towards a target where a scene comes without one.
    """
    if mesh is not None:
        return Given(config, mesh)
    path, given = Path(config.shape), config.given
    if given is not None and given.digest:
        raise InputError(
            f"a record does not know where {config.shape} lies; give the path of the mesh or scene"
        )
    if not is_own(config):
        return Given(config, find_mesh(config.shape))
    if given is not None or (path.is_dir() and model_folder(scene_root(path)).is_dir()):
        return _scene(config)
    mesh = find_mesh(config.shape)
    own = GivenConfig(digest=mesh_hash(mesh))
    return Given(replace(config, shape=path.resolve().name, given=own), mesh)


def _scene(config: RunConfig) -> Given:
    """Return the scene in the folder `config.shape` with its target, if any."""
    root, given, loss = scene_root(config.shape), config.given or GivenConfig(), config.loss
    name = scene_name(root)
    plain = RunConfig(config.shape)
    unused = [each for each in RENDERED if getattr(config, each) != getattr(plain, each)]
    if unused:
        raise InputError(
            f"{', '.join(unused)} would change scenes that are rendered from a mesh, not the one in {root}; "
            "leave out --set of it, or see --downscale and --background"
        )
    if given.target is None:
        if config.allocation is not None or (loss is not None and loss.kind in NEEDS_TARGET):
            raise InputError(
                f"condition {config.condition} acts towards a target, which photographs do not bring: give "
                "--target MESH|bundle.json, or train with C0, or T3 with --betti"
            )
        target, mesh, bundle = None, None, None
    elif Path(given.target).suffix == ".json":
        from paper_artifact.topology.bundle import load_bundle

        mesh, bundle = None, load_bundle(given.target)
        target = file_digest(Path(given.target))
        if config.allocation is not None:
            raise InputError(f"condition {config.condition} needs a mesh as --target, not a bundle")
        if loss is not None and loss.kind in NEEDS_TARGET:
            its: dict[str, Any] = {
                "samples": bundle.samples,
                "dimensions": bundle.dimensions,
                "bundle_seed": bundle.seed,
            }
            for setting, value in its.items():
                if getattr(loss, setting) not in (value, getattr(LossConfig(), setting)):
                    raise InputError(
                        f"{setting} is {value} in {given.target}; leave out --loss {setting}, or give "
                        "a mesh as --target"
                    )
            loss = replace(loss, **its)
    else:
        mesh, bundle = find_mesh(given.target), None
        target = mesh_hash(mesh)
    given = replace(given, digest=scene_digest(root), target=target)
    return Given(replace(config, shape=name, loss=loss, given=given), mesh, root, bundle)
