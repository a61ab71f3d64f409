"""Discs over rims: surgery along a loop that `ingest.handles` finds, and the holes of a scan.

Surgery cuts a handle or fills a hole of a closed surface. The triangles along the loop go, and each of the
two rims is closed by the disc of least area that crosses nothing. Where there is none, the band is made
wider, as rims away from a crease have discs more often. The discs over a scan's holes are of least area too,
but may cross what they like: they are for the solid of all that lies near them.
"""

from __future__ import annotations

import numpy as np

from paper_artifact.certify.homology import edges_of
from paper_artifact.errors import InputError
from paper_artifact.frame import frame_for
from paper_artifact.ingest.crossings import crossing_faces, crossing_segments
from paper_artifact.ingest.handles import Loop
from paper_artifact.kernel_cache import njit
from paper_artifact.mesh import Mesh, checked_mesh, weld

CORNERS = 300  # of a rim that its disc has at most; the others are joined to the two beside them

ATTEMPTS = 5  # of surgery, with finer triangles or a wider band
TRIES = 30  # of a disc, each without a diagonal of the last


def cut_and_capped(mesh: Mesh, loop: Loop) -> Mesh:
    """Return the Mesh without the triangles along a loop, both rims closed by discs; its vertices are float32
    values, in the coordinates of its `frame_for` where it lies far away or is huge or tiny.

    That cuts a handle, and fills a hole by a plate as thick as the triangles are wide. Raises InputError
    where a disc would cross the surface, as in a hole that is knotted or that something passes through.
    """
    frame = frame_for(mesh.centre, mesh.radius)
    vertices, faces, path = frame.inward(mesh.vertices), mesh.faces, loop.vertices
    band = path
    for _ in range(ATTEMPTS):
        rounded = vertices.astype(np.float32).astype(np.float64)
        removed = np.isin(faces, band).any(axis=1)
        whole, rims = faces[~removed], _rims(faces[~removed])
        if len(rims) == 2:
            for rim in rims:
                whole = np.concatenate([whole, cap]) if len(cap := _cap(rounded, whole, rim)) else whole[:0]
            if len(whole):
                rounded, whole = weld(rounded, whole)
                return checked_mesh(frame.outward(rounded), whole, mesh.name)
            band = np.unique(faces[removed])
        elif band is path:
            vertices, faces, path = _finer(vertices, faces, path)
            band = path
        else:
            break
    raise InputError(
        f"no disc closes this {loop.kind} without crossing the surface: something passes through it, or its "
        "loop is knotted or bent; choose another, or mend the mesh in a mesh editor"
    )


def _cap(vertices: np.ndarray, faces: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Return the triangles (n-2,3) of a disc that closes a rim (n,) of the faces and crosses none of them;
    none where no such disc is found."""
    if len(faces) == 0:
        return faces
    pairs = np.stack(np.meshgrid(rim, rim, indexing="ij"), axis=-1)
    edges = edges_of(faces, len(vertices))[0] @ (len(vertices), 1)
    taken = np.isin(np.sort(pairs, axis=-1) @ (len(vertices), 1), edges)
    apart = np.triu_indices(len(rim), 2)
    taken[apart] |= crossing_segments(vertices, faces, pairs[apart])
    near = np.isin(np.arange(len(vertices)), rim)
    for _ in range(TRIES):
        disc = _disc(vertices[rim], taken)
        crossing = crossing_faces(vertices, np.concatenate([faces, rim[disc]]), changed=near)[len(faces) :]
        if len(disc) and not crossing.any():
            return rim[disc]
        for i, k, j in disc[crossing].tolist():  # without its longest side, unless that is of the rim
            sides = [(a, b) for a, b in ((i, k), (k, j), (i, j)) if 1 < b - a < len(rim) - 1]
            if sides:
                taken[max(sides, key=lambda side: np.ptp(vertices[rim[list(side)]], axis=0).max())] = True
        if not len(disc):
            break
    return faces[:0]


def _rims(kept: np.ndarray) -> list[np.ndarray]:
    """Return the closed chains of vertices where faces are missing, in the direction that a disc there has;
    none where a chain meets itself or another one."""
    sides = np.concatenate([kept[:, [0, 1]], kept[:, [1, 2]], kept[:, [2, 0]]])
    base = int(kept.max()) + 1
    border = sides[~np.isin(sides @ (base, 1), sides @ (1, base))]
    after = dict(border[:, ::-1].tolist())
    rims: list[np.ndarray] = []
    if len(after) < len(border):
        return rims
    while after:
        rim = [next(iter(after))]
        while (step := after.pop(rim[-1])) != rim[0]:
            rim.append(step)
        rims.append(np.array(rim))
    return rims


def _finer(vertices: np.ndarray, faces: np.ndarray, path: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return a mesh and a closed path with every edge halved, every triangle cut into four."""
    edges, sides = edges_of(faces, len(vertices))
    ab, bc, ca = (len(vertices) + sides).T
    a, b, c = faces.T
    four = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    ends = np.sort(np.stack([path, np.roll(path, -1)], axis=1), axis=1) @ (len(vertices), 1)
    halves = len(vertices) + np.searchsorted(edges @ (len(vertices), 1), ends)
    return (
        np.concatenate([vertices, vertices[edges].mean(axis=1)]),
        np.concatenate([np.stack(each, axis=1) for each in four]),
        np.stack([path, halves], axis=1).reshape(-1),
    )


@njit(cache=True)
def _disc(points: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """Return the triangles (n-2,3) of a closed chain (n,3) that have the least area together, without the
    diagonals that are `taken` (n,n); none where there is no such disc (Barequet and Sharir 1995)."""
    n = len(points)
    x, y, z = points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy()
    cost, middle = np.zeros((n, n)), np.zeros((n, n), dtype=np.int64)
    for span in range(2, n):
        for i in range(n - span):
            j = i + span
            cost[i, j] = np.inf
            if taken[i, j] and span < n - 1:
                continue
            for k in range(i + 1, j):
                ux, uy, uz = x[k] - x[i], y[k] - y[i], z[k] - z[i]
                vx, vy, vz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
                nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
                total = cost[i, k] + cost[k, j] + np.sqrt(nx * nx + ny * ny + nz * nz)
                if total < cost[i, j]:
                    cost[i, j], middle[i, j] = total, k
    triangles = np.empty((n - 2 if np.isfinite(cost[0, n - 1]) else 0, 3), dtype=np.int64)
    if len(triangles) == 0:
        return triangles
    stack, count = [(0, n - 1)], 0
    while len(stack) > 0:
        i, j = stack.pop()
        if j - i < 2:
            continue
        k = middle[i, j]
        triangles[count, 0], triangles[count, 1], triangles[count, 2] = i, k, j
        count += 1
        stack.append((i, k))
        stack.append((k, j))
    return triangles


def without_holes(mesh: Mesh, widest: float) -> tuple[Mesh, list[float]]:
    """Return a raw Mesh, welded, with a disc over every hole at most `widest` across (world units), and how
    far all of its holes are across, the widest first.

    A hole is a closed chain of edges with an odd number of triangles. A loose triangle is left as it is.
    """
    vertices, faces = weld(mesh.vertices, mesh.faces)
    edges, sides = edges_of(faces, len(vertices))
    odd = np.bincount(sides.reshape(-1), minlength=len(edges)) % 2 == 1
    odd[sides[odd[sides].all(axis=1)]] = False
    rims = _chains(edges[odd])
    across = [float(np.ptp(vertices[rim], axis=0).max()) for rim in rims]
    discs = [_rough_disc(vertices, rim) for rim, size in zip(rims, across, strict=True) if size <= widest]
    return Mesh(vertices, np.concatenate([faces, *discs]), mesh.name), sorted(across, reverse=True)


def _chains(edges: np.ndarray) -> list[np.ndarray]:
    """Return edges (n,2), an even number at each vertex, as closed chains that pass a vertex once."""
    beside: dict[int, set[int]] = {}
    for a, b in edges.tolist():
        beside.setdefault(a, set()).add(b)
        beside.setdefault(b, set()).add(a)
    chains = []
    for start in beside:
        path, place = [start], {start: 0}
        while beside[path[-1]]:
            step = beside[path[-1]].pop()
            beside[step].discard(path[-1])
            if step not in place:
                place[step] = len(path)
                path.append(step)
                continue
            chains.append(np.array(path[place[step] :]))
            for left in path[place[step] + 1 :]:
                del place[left]
            del path[place[step] + 1 :]
    return chains


def _rough_disc(vertices: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Return triangles (n,3) over a rim (n,): the disc of least area of at most CORNERS of its vertices, and
    those that join the others to it."""
    at = np.arange(len(rim))
    corners = np.unique(np.rint(np.linspace(0, len(rim) - 1, min(len(rim), CORNERS))).astype(int))
    disc = _disc(vertices[rim[corners]], np.zeros((len(corners), len(corners)), dtype=bool))
    before = corners[np.searchsorted(corners, at, side="right") - 1]
    fans = np.stack([before, at, np.roll(at, -1)], axis=1)[before != at]
    return rim[np.concatenate([corners[disc], fans])]
