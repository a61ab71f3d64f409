"""The triangle soup: what is trained, its file, and its images as an evaluation sees them.

Letters: T triangles. Every triangle owns its three corners; nothing is shared. Features and opacity are
logits and pass through a sigmoid wherever they are used. The shading MLP belongs to the soup, since the
features mean nothing without it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from os.path import isfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from paper_artifact.archives import load_npz, write_npz
from paper_artifact.errors import InputError
from paper_artifact.files import load_json, run_record
from paper_artifact.frame import SAME, Frame
from paper_artifact.randomness import stream
from paper_artifact.raster.arrays import FEATURES, HIDDEN, MLP_SHAPES, SoupArrays, sigmoid
from paper_artifact.raster.view import ViewRaster, make_camera
from paper_artifact.scene.load import Scene

MOST_SHADING = 1e8  # of features, opacity and weights: colours stay finite in float32
SIGNATURE = "sha256"  # a file's array: the digest of its others


@dataclass(frozen=True)
class Soup:
    """vertices (T,3,3) float32 world; features (T,3,7) and opacity (T,3) float32 logits; mlp: see
    `MLP_SHAPES`, as torch.nn.Linear."""

    vertices: torch.Tensor
    features: torch.Tensor
    opacity: torch.Tensor
    mlp: tuple[torch.Tensor, ...]

    def __len__(self) -> int:
        return len(self.vertices)

    def select(self, triangles: torch.Tensor, vertices: torch.Tensor | None = None) -> Soup:
        """Return a new soup of the triangles with these indices (K,) int64, features carried along; vertices
        (K,3,3) replace positions."""
        with torch.no_grad():
            moved = self.vertices[triangles] if vertices is None else vertices
            return Soup(
                moved.clone(), self.features[triangles].clone(), self.opacity[triangles].clone(), self.mlp
            ).trainable()

    def trainable(self) -> Soup:
        """Return the same soup with every tensor a leaf that requires a gradient."""
        for tensor in self.tensors():
            tensor.requires_grad_(True)
        return self

    def tensors(self) -> tuple[torch.Tensor, ...]:
        """Return the nine tensors: vertices, features, opacity and the MLP's six."""
        return (self.vertices, self.features, self.opacity, *self.mlp)

    def drawn(self) -> SoupArrays:
        """Return what the CPU rasterizer draws: features and opacity through the sigmoid, the rest as it
        is."""
        vertices, features, opacity, *mlp = (
            np.ascontiguousarray(tensor.detach().cpu().numpy(), np.float32) for tensor in self.tensors()
        )
        return SoupArrays(vertices, sigmoid(features), sigmoid(opacity), tuple(mlp))

    def corner_opacity(self) -> np.ndarray:
        """Return the corners' opacities (T,3) float32 in [0,1]."""
        return sigmoid(self.opacity.detach().cpu().numpy())


def soup_of(tensors: Sequence[torch.Tensor]) -> Soup:
    """Return the soup of the tensors vertices, features, opacity and the MLP's, in this order."""
    vertices, features, opacity, *mlp = tensors
    return Soup(vertices, features, opacity, tuple(mlp))


def initial_mlp(seed: int) -> tuple[torch.Tensor, ...]:
    """Return the shading MLP's start (DiffSoup `multires.py`).

    Kaiming-uniform hidden layers, Xavier-uniform last one, zero biases.
    """
    draws = stream(seed, "mlp")
    tensors = []
    for shape in MLP_SHAPES:
        if len(shape) == 1:
            tensors.append(torch.zeros(shape))
            continue
        outputs, inputs = shape
        bound = np.sqrt(6.0 / inputs) if outputs == HIDDEN else np.sqrt(6.0 / (inputs + outputs))
        tensors.append(torch.from_numpy((bound * (2 * draws.random(shape) - 1)).astype(np.float32)))
    return tuple(tensors)


def save_soup(path: Path | str, soup: Soup, frame: Frame = SAME) -> str:
    """Write the soup as .npz (vertices, features, opacity, mlp_0 … mlp_5), atomically, and return the SHA-256
    of its arrays, which the run's record keeps.

    frame: of its coordinates, kept beside them ("offset", "exponent") where it is not the user's. Raises
    InputError when the folder is not writable or the disk is full.
    """
    tensors = {"vertices": soup.vertices, "features": soup.features, "opacity": soup.opacity}
    tensors |= {f"mlp_{index}": tensor for index, tensor in enumerate(soup.mlp)}
    arrays: dict[str, Any] = {name: tensor.detach().cpu().numpy() for name, tensor in tensors.items()}
    if frame != SAME:
        arrays |= {"offset": np.array(frame.offset), "exponent": np.array(frame.exponent)}
    digest = _digest(arrays)
    write_npz(path, arrays | {SIGNATURE: np.array(digest)})
    return digest


def signed(path: Path | str) -> bool:
    """Return whether the soup file at `path` is as `save_soup` wrote it. Raises as `load_npz` does."""
    arrays = load_npz(path)
    return str(arrays.get(SIGNATURE)) == _digest(arrays)


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    """Return the SHA-256 of the arrays but SIGNATURE, by name, as little-endian numbers."""
    state = hashlib.sha256()
    for name, array in sorted((name, array) for name, array in arrays.items() if name != SIGNATURE):
        state.update(f"{name} {array.dtype.name} {array.shape}".encode())
        state.update(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())
    return state.hexdigest()


def load_soup(path: Path | str) -> Soup:
    """Read a soup that `save_soup` wrote. Raises InputError when the file is missing, damaged, no soup, or
    soups/NAME.npz but not the soup of which the record runs/NAME.json beside it speaks."""
    path = Path(path)
    if not isfile(path):  # False for a name that is too long
        raise InputError(f"no soup at {path}: train one with `python -m paper_artifact train`")
    try:
        data = load_npz(path)
        names = ("vertices", "features", "opacity", *(f"mlp_{index}" for index in range(len(MLP_SHAPES))))
        with np.errstate(over="ignore", invalid="ignore"):
            tensors = [torch.from_numpy(data[name].astype(np.float32, casting="same_kind")) for name in names]
    except PermissionError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; check its permissions") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is not a readable soup ({error}); export or train it again") from error
    if fault := soup_fault(tensors):
        raise InputError(f"{path} does not hold a soup: {fault}; export or train it again")
    record, digest = run_record(path), None
    with suppress(OSError, ValueError, KeyError, TypeError):  # without a record of it, it is what it is
        digest = load_json(record)["soup"]["sha256"] if path.parent.name == "soups" else None
    if digest not in (None, _digest(data)):
        raise InputError(
            f"{path} is not the soup of its record {record}; move one of them, or train it again"
        )
    return soup_of(tensors)


def soup_fault(tensors: Sequence[torch.Tensor]) -> str | None:
    """Return why the tensors are none of a soup's, for `soup_of`; None where they are."""
    shapes = [tuple(tensor.shape) for tensor in tensors]
    count = shapes[0][0] if shapes and shapes[0] else 0
    if count == 0 or shapes != [(count, 3, 3), (count, 3, FEATURES), (count, 3), *MLP_SHAPES]:
        return f"array shapes {shapes}"
    if any(tensor.dtype != torch.float32 or not torch.isfinite(tensor).all() for tensor in tensors):
        return "values that are not finite, or no float32"
    if max(float(tensor.detach().abs().max()) for tensor in tensors[1:]) > MOST_SHADING:
        return f"colours beyond {MOST_SHADING:g}"
    return None


def load_frame(path: Path | str) -> Frame:
    """Return the frame of the coordinates in a soup's file that `load_soup` can read.

    Raises InputError for one that no run writes: `offset` and `exponent` are three finite numbers and a whole
    one that keep the soup finite.
    """
    data = load_npz(path)
    if not {"offset", "exponent"} & data.keys():
        return SAME
    try:
        x, y, z = (float(value) for value in data["offset"])
        frame = Frame((x, y, z), exponent := int(data["exponent"]))
        if exponent != data["exponent"]:
            raise ValueError(f"{data['exponent']} is no whole number")
        with np.errstate(over="ignore"):
            if np.isfinite(frame.outward(data["vertices"])).all():
                return frame
        reason = "it takes the soup to where numbers are not finite"
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        reason = str(error)
    raise InputError(f"the frame (offset, exponent) of the soup {path} is damaged: {reason}; train it again")


def reframed(soup: Soup, old: Frame, new: Frame) -> Soup:
    """Return the soup in coordinates of the frame `new` instead of `old`; itself where they are equal."""
    if old == new:
        return soup
    moved = new.inward(old.outward(soup.vertices.detach().numpy().astype(np.float64)))
    return Soup(torch.from_numpy(np.asarray(moved, np.float32)), soup.features, soup.opacity, soup.mlp)


def render_views(
    soup: Soup, scene: Scene, views: np.ndarray | Sequence[int], supersample: int = 1
) -> np.ndarray:
    """Return the soup's images (n,H,W,3) float32 in [0,1] of the scene's views (indices (n,)), rendered at
    the threshold .5; a pixel is the mean of supersample × supersample rays on a regular grid in it."""
    height, width = scene.images.shape[2:]
    drawn, raster = soup.drawn(), ViewRaster(height * supersample, width * supersample)
    cameras = [make_camera(scene.world_to_clip[view]) for view in views]
    colours = [_pixels(raster.render(drawn, camera, scene.background), supersample) for camera in cameras]
    return np.stack(colours).transpose(0, 2, 3, 1)


def _pixels(rays: np.ndarray, supersample: int) -> np.ndarray:
    """Return the means (3,H,W) of square blocks of rays (3,H·s,W·s), as an array of its own."""
    if supersample == 1:
        return rays.copy()
    channels, height, width = rays.shape
    blocks = rays.reshape(channels, height // supersample, supersample, width // supersample, supersample)
    return blocks.mean(axis=(2, 4), dtype=np.float32)
