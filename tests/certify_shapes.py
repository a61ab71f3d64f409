"""Surfaces of known homology, as vertices and faces."""

import numpy as np
import trimesh

from paper_artifact.scene.shapes import make_shape


def voxel_surface(solid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The boundary of a set of unit cubes, solid (x,y,z) bool, wound outwards; corners shared."""
    solid = np.pad(solid, 1)
    points, faces = {}, []
    for axis in range(3):
        for sign in (0, 1):
            neighbour = np.roll(solid, 1 - 2 * sign, axis=axis)
            u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
            for cell in np.argwhere(solid & ~neighbour):
                base = cell + sign * np.eye(3, dtype=int)[axis]
                quad = [base, base + u, base + u + v, base + v][:: 1 if sign else -1]
                ids = [points.setdefault(tuple(p.tolist()), len(points)) for p in quad]
                faces += [[ids[0], ids[1], ids[2]], [ids[0], ids[2], ids[3]]]
    return np.array(list(points), dtype=float), np.array(faces)


def plate(holes: int) -> tuple[np.ndarray, np.ndarray]:
    """A plate with square holes: a closed surface of that genus."""
    solid = np.ones((2 * holes + 1, 3, 1), dtype=bool)
    solid[1::2, 1] = False
    return voxel_surface(solid)


def band(length: int, twist: bool, width: int = 3, closed: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """A strip of quads glued at its ends, with a half twist or without; `closed` glues the sides too (torus,
    Klein bottle).

    The points are of no use but to be different ones: the topology is in the faces.
    """
    rows = width if closed else width + 1
    index = np.arange(length * rows).reshape(length, rows)
    after = np.concatenate([index[1:], (index[:1, ::-1] if twist else index[:1])])
    faces = []
    for here, there in zip(index, after, strict=True):
        for i in range(width):
            j = (i + 1) % rows
            faces += [[here[i], there[i], there[j]], [here[i], there[j], here[j]]]
    angle = 2 * np.pi * np.arange(length * rows) / (length * rows)
    return np.stack([np.cos(angle), np.sin(angle), angle], axis=1), np.array(faces)


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    faces = [np.asarray(faces) + offset for (_, faces), offset in zip(parts, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def ball(
    radius: float = 1.0, centre: tuple[float, float, float] = (0, 0, 0), inwards: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    sphere = trimesh.creation.icosphere(2)
    return sphere.vertices * radius + centre, sphere.faces[:, ::-1] if inwards else sphere.faces


def tetrahedron(shift: float = 0.0, sign: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float) * sign + shift
    return vertices, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])[:, :: int(sign)]


def bowl() -> tuple[np.ndarray, np.ndarray]:
    mesh = make_shape("bowl_wide")
    return mesh.vertices, mesh.faces


def numbered(count: int, faces: str) -> tuple[np.ndarray, np.ndarray]:
    """Faces such as "014 015" over points of no use but to be different ones."""
    points = np.eye(count)[:, :3] + np.arange(count)[:, None]
    return points, np.array([list(map(int, face)) for face in faces.split()])


PROJECTIVE_PLANE = numbered(6, "014 015 023 024 035 123 125 134 245 345")
TETRAHEDRA_WITH_A_COMMON_EDGE = numbered(6, "012 013 023 123 014 015 045 145")


# name: (surface, Betti numbers over Z/2, verdict, a word of its first reason or its kind)
KNOWN = {f"genus {g}": (plate(g), (1, 2 * g, 1), "pass", f"genus {g}") for g in range(6)} | {
    "two balls": (joined(ball(), ball(centre=(3, 0, 0))), (2, 0, 2), "pass", "2 × closed surface, genus 0"),
    "nested shells": (joined(ball(), ball(0.5, inwards=True)), (2, 0, 2), "pass", "2 × closed surface"),
    "ball and plates": (
        joined(ball(), plate(2), (plate(1)[0] + 9, plate(1)[1])),
        (3, 6, 3),
        "pass",
        "genus 2",
    ),
    "pinched vertex": (joined(tetrahedron(), tetrahedron(sign=-1)), (1, 0, 2), "fail", "1 pinched vertex"),
    "common edge": (TETRAHEDRA_WITH_A_COMMON_EDGE, (1, 0, 2), "fail", "1 edge with more than two faces"),
    "Möbius strip": (band(9, twist=True), (1, 1, 0), "fail", "open edges in 1 boundary loop"),
    "annulus": (band(9, twist=False), (1, 1, 0), "fail", "18 open edges in 2 boundary loops"),
    "Klein bottle": (band(9, twist=True, width=5, closed=True), (1, 2, 1), "fail", "not orientable"),
    "torus": (band(9, twist=False, width=5, closed=True), (1, 2, 1), "pass", "genus 1"),
    "projective plane": (PROJECTIVE_PLANE, (1, 1, 1), "fail", "odd Euler"),
    "bowl": (bowl(), (1, 0, 0), "fail", "in 1 boundary loop"),
    "one triangle": ((np.eye(3), np.array([[0, 1, 2]])), (1, 0, 0), "fail", "3 open edges"),
    "triangle twice": ((np.eye(3), np.array([[0, 1, 2], [1, 2, 0]])), (1, 0, 0), "fail", "1 duplicate face"),
}
