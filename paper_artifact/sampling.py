"""Uniform random points on a triangle surface: the cloud under every alpha complex here (paper, Method)."""

from __future__ import annotations

from typing import Any

import numpy as np

from paper_artifact.arithmetic import dot, norm
from paper_artifact.errors import InputError, as_numbers, require_memory, whole

MANY, BYTES = 10**7, 150  # samples for which memory is asked about first, and what one takes


def check_indices(vertices: Any, faces: Any, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V,3) as float64 and faces (F,3) as int64.

    Raises InputError, naming `name`, for other shapes, what are no numbers, or a face that refers to a
    fraction or to none of the vertices.
    """
    advice = "give vertices (V, 3) and faces (F, 3) of whole numbers"
    vertices = np.asarray(as_numbers(vertices, f"the vertices of {name}", advice), dtype=np.float64)
    given = as_numbers(faces, f"the faces of {name}", advice)
    vertices, given = (each if each.size else each.reshape(-1, 3) for each in (vertices, given))
    if not all(each.ndim == 2 and each.shape[1] == 3 for each in (vertices, given)):
        raise InputError(f"{name} has vertices {vertices.shape} and faces {given.shape}; {advice}")
    with np.errstate(invalid="ignore"):
        faces = given.astype(np.int64, copy=False)
    if faces is not given and (wrong := given[faces != given]).size:
        raise InputError(f"{name} has a face that refers to vertex {wrong[0]}, no whole number; {advice}")
    wrong = faces[(faces < 0) | (faces >= len(vertices))]
    if wrong.size:
        raise InputError(
            f"{name} has a face that refers to vertex {wrong[0]} of {len(vertices)}, counted from 0; the "
            "mesh is damaged or cut off, export it again"
        )
    return vertices, faces


def check_arrays(vertices: Any, faces: Any, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V,3) float64 and faces (F,3) int64.

    Raises InputError, naming `name`, as `check_indices` does, for no faces, NaN and infinity.
    """
    vertices, faces = check_indices(vertices, faces, name)
    if len(faces) == 0:
        raise InputError(f"{name} has no triangles; give a surface mesh, not points or curves")
    if not np.isfinite(vertices).all():
        count = int((~np.isfinite(vertices).all(axis=1)).sum())
        raise InputError(
            f"{name} has {count} vertices with NaN or infinite coordinates; repair or export it again"
        )
    return vertices, faces


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the areas (F,) float64 of triangles `faces` (F,3), in squared units of `vertices` (V,3)."""
    corner = np.asarray(vertices, dtype=np.float64)[faces]
    return norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])) / 2


def sample_surface(
    vertices: np.ndarray,
    faces: np.ndarray,
    count: int,
    generator: np.random.Generator,
    weights: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw `count` independent points on the triangles; return (points, face indices, barycentrics).

    points (count,3) float64 world units; face indices (count,) int64; barycentrics (count,3) float64 of the
    faces' three corners. The density is proportional to area × weight. vertices (V,3) any float, world units;
    faces (F,3) integer; weights (F,) ≥ 0, for example triangle opacities, or None for uniform by area.

    Construction, fixed so that equal arguments give equal points: u = generator.random((3, count)); the face
    is the inverse of the cumulated area × weight at u[0]; with s = sqrt(u[1]) the barycentrics are (1 - s,
    s (1 - u[2]), s u[2]), uniform on the triangle (Osada et al. 2002, Shape Distributions, eq. 1).

    Raises InputError for a negative count, one that memory does not hold, faces of other vertices, or when no
    area × weight is left to draw from.
    """
    count = whole("the number of samples", count, 0, 10**15)
    if count > MANY:
        require_memory(BYTES * count, f"{count} samples", "give fewer samples")
    if not isinstance(generator, np.random.Generator):
        raise InputError(f"the generator is {generator!r:.60}; give numpy's, as stream(seed, 'a name') does")
    vertices, faces = check_indices(vertices, faces, "the surface")
    with np.errstate(over="ignore", invalid="ignore"):  # refused below
        mass = face_areas(vertices, faces)
    if weights is not None:
        weights = as_numbers(weights, "the weights", f"give {len(faces)} numbers, one a face")
        if weights.shape != mass.shape:
            raise InputError(f"the weights have shape {weights.shape}; give {len(faces)}, one a face")
        mass = mass * np.asarray(weights, dtype=np.float64)
    cumulated = np.cumsum(mass)
    if len(mass) == 0 or not np.isfinite(cumulated[-1]) or mass.min() < 0 or cumulated[-1] <= 0:
        raise InputError(
            "the surface to sample has no finite, positive area × weight; check its triangles and opacities"
        )
    u = generator.random((3, count))
    # side="right" skips faces of no mass; u < 1 keeps u·total below the total but for rounding, hence the cap
    # at the last face that has mass.
    face = np.searchsorted(cumulated, u[0] * cumulated[-1], side="right")
    face = np.minimum(face, np.flatnonzero(mass)[-1])
    root = np.sqrt(u[1])
    barycentrics = np.stack([1 - root, root * (1 - u[2]), root * u[2]], axis=1)
    points = dot(barycentrics[:, None], np.swapaxes(vertices[faces[face]], 1, 2))
    return points, face.astype(np.int64), barycentrics


def sample_soup(
    vertices: np.ndarray, opacity: np.ndarray | None, count: int, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw `count` points of a triangle soup with density area × α; returns and errors as `sample_surface`.

    vertices (T,3,3) float, world units; opacity (T,3) float in [0,1] (after the sigmoid), of which α is a
    triangle's mean, or None for 1 (paper §3.2). Raises InputError also for wrong shapes, coordinates that are
    not finite or opacities outside [0,1].
    """
    vertices = np.asarray(as_numbers(vertices, "the soup's vertices", "give (T,3,3)"), dtype=np.float64)
    given = None if opacity is None else as_numbers(opacity, "the soup's opacities", "give (T,3)")
    shape = vertices.shape[:2] if given is None else given.shape
    if vertices.ndim != 3 or vertices.shape[1:] != (3, 3) or shape != vertices.shape[:2]:
        raise InputError(f"a soup has vertices (T,3,3) and opacity (T,3), got {vertices.shape} and {shape}")
    alpha = None if given is None else np.asarray(given, dtype=np.float64)
    if not np.isfinite(vertices).all() or not (alpha is None or ((alpha >= 0) & (alpha <= 1)).all()):
        raise InputError(
            "the soup holds coordinates that are not finite or opacities outside [0, 1]; "
            "its training has diverged"
        )
    faces = np.arange(3 * len(vertices)).reshape(-1, 3)
    weights = None if alpha is None else alpha.mean(axis=1)
    return sample_surface(vertices.reshape(-1, 3), faces, count, generator, weights)
