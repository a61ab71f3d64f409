"""A procedural hot pot with a flue, in the role of the paper's tom-yum pot, which is not public.

Like the paper's export (suppl. B, Table S4) it is raw: nine overlapping open shells, quads mixed with
12-gons, junction edges where three shells meet, no inside. After ingest it is one body of genus 3: two slot
handles and one vent slot give six thin loops, and the flue with its narrow mouth is open, so that its chamber
is a void only to a measurement. It is a substitute, not the paper's pot. `inventory` measures what makes it
hard.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from paper_artifact.certify.homology import labels_of_graph
from paper_artifact.ingest.solidify import Solid, solidify
from paper_artifact.mesh import Mesh, checked_mesh

NAME = "pot"
OFFSET = 0.0065  # ε / diagonal of the raw pot
CELLS = 2.0

AROUND = 60  # segments of body and foot
SIDES = 12  # of the flue and of the handles' cross-section
FLOOR_RADIUS, RIM_RADIUS, RIM_HEIGHT, FOOT_DEPTH = 0.22, 0.40, 0.22, 0.10
FLUE_RADIUS, MOUTH_RADIUS, FLUE_HEIGHT, SHOULDER_HEIGHT, NECK_HEIGHT = 0.0955, 0.036, 0.24, 0.30, 0.33
HANDLE_GAP, HANDLE_TUBE, HANDLE_ANGLE, HANDLE_HEIGHT = 0.036, 0.012, 0.30, 0.10


Shell = tuple[np.ndarray, list[tuple[int, ...]]]  # points and polygons


@dataclass(frozen=True, eq=False)
class RawPot:
    """The pot as modelled: nine open shells of polygons."""

    vertices: np.ndarray  # (V,3) float64, model units
    polygons: tuple[tuple[int, ...], ...]  # vertex indices of each, 4 or 12

    def mesh(self) -> Mesh:
        """Return the pot as a Mesh: polygons split by the fan 0–2, points not welded."""
        faces = [(p[0], p[i], p[i + 1]) for p in self.polygons for i in range(1, len(p) - 1)]
        return checked_mesh(self.vertices, np.array(faces), NAME, welded=False)


def raw_pot() -> RawPot:
    """Return the raw pot: wall, floor, foot with a vent slot, flue chamber, neck and bottom, two handles,
    rim.
    """
    shells = [
        _revolve(
            [(FLOOR_RADIUS, 0.0), (0.265, 0.055), (0.31, 0.11), (0.355, 0.165), (RIM_RADIUS, RIM_HEIGHT)],
            AROUND,
        ),
        _revolve([(FLOOR_RADIUS, 0.0), (0.16, 0.0), (0.10, 0.0), (0.05, 0.0)], AROUND),
        _revolve(
            [(FLOOR_RADIUS, 0.0), (0.223, -0.03), (0.227, -0.066), (0.23, -FOOT_DEPTH)],
            AROUND,
            leave_out={(1, 14), (1, 15), (1, 16)},
        ),
        _revolve([(FLUE_RADIUS, 0.0), (FLUE_RADIUS, FLUE_HEIGHT / 2), (FLUE_RADIUS, FLUE_HEIGHT)], SIDES),
        _revolve(
            [(FLUE_RADIUS, FLUE_HEIGHT), (MOUTH_RADIUS, SHOULDER_HEIGHT), (MOUTH_RADIUS, NECK_HEIGHT)], SIDES
        ),
        (_ring(FLUE_RADIUS, 0.0, SIDES), [tuple(range(SIDES))]),
        _handle(0.0),
        _handle(np.pi),
        _revolve([(RIM_RADIUS, RIM_HEIGHT), (0.425, 0.21), (0.415, 0.175), (0.355, 0.165)], AROUND),
    ]
    polygons: list[tuple[int, ...]] = []
    start = 0
    for points, faces in shells:
        polygons += [tuple(start + i for i in face) for face in faces]
        start += len(points)
    return RawPot(np.concatenate([points for points, _ in shells]), tuple(polygons))


def pot_solid() -> Solid:
    """Return the raw pot, ingested with the offset that its loops and its flue are tuned to."""
    return solidify(raw_pot().mesh(), OFFSET, CELLS)


def _ring(radius: float, height: float, count: int) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, height)], axis=1)


def _revolve(
    profile: list[tuple[float, float]], count: int, leave_out: Collection[tuple[int, int]] = ()
) -> Shell:
    """Return points and quads of a (radius, height) profile turned around z; leave_out: (band, segment)
    without one.
    """
    points = np.concatenate([_ring(radius, height, count) for radius, height in profile])
    return points, _quads(len(profile) - 1, count, leave_out)


def _quads(bands: int, count: int, leave_out: Collection[tuple[int, int]] = ()) -> list[tuple[int, ...]]:
    """Return the quads between consecutive closed rings of `count` points, band by band."""
    return [
        (b * count + i, b * count + (i + 1) % count, (b + 1) * count + (i + 1) % count, (b + 1) * count + i)
        for b in range(bands)
        for i in range(count)
        if (b, i) not in leave_out
    ]


def _handle(direction: float) -> Shell:
    """Return points and faces of a bar outside of the wall: a 12-sided tube, capped at one end."""
    wall = FLOOR_RADIUS + (RIM_RADIUS - FLOOR_RADIUS) * HANDLE_HEIGHT / RIM_HEIGHT
    angles = direction + HANDLE_ANGLE * np.array([-1, -1, -0.5, 0, 0.5, 1, 1])
    radii = wall + np.array([0.0, 1, 1, 1, 1, 1, 0]) * (HANDLE_GAP + HANDLE_TUBE)
    path = np.stack([radii * np.cos(angles), radii * np.sin(angles), np.full(7, HANDLE_HEIGHT)], axis=1)
    steps = np.diff(path, axis=0) / np.linalg.norm(np.diff(path, axis=0), axis=1, keepdims=True)
    tangent = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0])
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    points = np.concatenate(
        [
            p + HANDLE_TUBE * (np.cos(turn)[:, None] * up + np.sin(turn)[:, None] * np.cross(t, up))
            for p, t in zip(path, tangent, strict=True)
        ]
    )
    return points, [*_quads(len(path) - 1, SIDES), tuple(range(SIDES))]


def shells_as_indexed(pot: RawPot) -> int:
    """Return the number of connected pieces of the polygons as indexed, before any weld."""
    left = np.array([p[0] for p in pot.polygons for _ in p[1:]])
    right = np.array([i for p in pot.polygons for i in p[1:]])
    return len(np.unique(labels_of_graph(left, right, len(pot.vertices))))


def inventory(pot: RawPot, solid: Solid) -> list[tuple[str, str]]:
    """Return (challenge, measured consequence) rows of the raw pot and of its ingested shell."""
    corners = sorted(Counter(len(polygon) for polygon in pot.polygons).items())
    raw, shell = solid.raw, solid.certificate
    grid = " × ".join(map(str, solid.grid))
    return [
        (
            f"raw export ({len(pot.vertices)} vertices): {shells_as_indexed(pot)} open shells; "
            f"faces by corners: {', '.join(f'{times} of {size}' for size, times in corners)}",
            f"{raw.open_edges_as_indexed} open edges as indexed; after the exact weld {raw.open_edges} open "
            f"edges and {raw.nonmanifold_edges} non-manifold junction edges: certificate {raw.verdict}, "
            f"no inside, β of the raw complex {raw.betti}",
        ),
        (
            f"offset solidification at ε = {solid.offset:.4g} (cell {solid.cell:.4g}, grid {grid})",
            f"{solid.pockets} enclosed pockets dropped; {len(shell.components)} closed body of "
            f"{shell.vertices} vertices and {shell.faces} triangles",
        ),
        (
            "topology known by certificate only",
            f"{shell.verdict}: genus {shell.genus}, β = {shell.betti}, Euler characteristic {shell.euler}, "
            f"sha256 {solid.sha256[:16]}…",
        ),
    ]
