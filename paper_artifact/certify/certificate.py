"""The certificate of a mesh: exact weld, surface checks, exact homology, Euler characteristic, a verdict.

Paper §4 and suppl. G: a mesh that fails is excluded, never repaired. The topology is that of the mesh's own
triangles: self-intersections do not change it, and are not looked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from scipy.spatial import cKDTree

from paper_artifact.certify.homology import (
    SurfaceChecks,
    betti_numbers,
    check_surface,
    edges_of,
    labels_of_graph,
    make_complex,
    open_edge_count,
)
from paper_artifact.errors import InputError
from paper_artifact.mesh import Mesh, check_scale, weld
from paper_artifact.sampling import check_arrays

LONGEST = 12  # components that are listed
NEAR = 1e-6  # of the diagonal: single precision's rounding, a few times over
# What is counted per component and in all: fields of SurfaceChecks, Component and Certificate.
FAULTS = ("open_edges", "boundary_loops", "nonmanifold_edges", "pinched_vertices", "reversed_edges")


@dataclass(frozen=True)
class Component:
    """One connected component of the welded mesh."""

    vertices: int
    edges: int  # distinct
    faces: int  # distinct
    euler: int  # vertices - edges + faces
    betti: tuple[int, int, int]  # over Z/2
    expected: tuple[int, int, int] | None  # what the classification of surfaces gives; None for no manifold
    open_edges: int  # with one face
    boundary_loops: int  # closed chains of open edges
    nonmanifold_edges: int  # with more than two faces
    pinched_vertices: int  # whose faces form more than one fan
    reversed_edges: int  # whose two faces wind alike (wrongly)
    orientable: bool  # a consistent winding exists
    genus: int | None  # with boundary loops filled; crosscaps if not orientable; None for no manifold
    volume: float | None  # signed, cubic world units; None unless closed and consistently wound

    @property
    def manifold(self) -> bool:
        """Whether edges have at most two faces, vertices one fan of faces, and no face is repeated."""
        return self.expected is not None


@dataclass(frozen=True)
class Certificate:
    """What was measured of a mesh, and the verdict.

    Counts are those after the exact weld, unless "as indexed".
    """

    name: str
    vertices_as_indexed: int
    faces_as_indexed: int
    open_edges_as_indexed: int
    vertices: int
    edges: int  # distinct
    faces: int  # repeated ones each time
    collapsed_faces: int  # dropped by the weld: two corners became one point
    duplicate_faces: int  # repeats of another face
    flat_faces: int  # of zero area
    open_edges: int  # this and the next five: see Component, over all components
    boundary_loops: int
    nonmanifold_edges: int
    pinched_vertices: int
    reversed_edges: int
    orientable: bool
    euler: int  # of the distinct simplices
    euler_as_given: int  # with repeated faces each time
    betti: tuple[int, int, int]  # of the whole complex, over Z/2
    components: tuple[Component, ...]  # largest first
    kind: str  # as text
    with_boundary: bool  # whether open edges were allowed
    verdict: str  # "pass" or "fail"
    reasons: tuple[str, ...]  # of a failure
    notes: tuple[str, ...]  # what is odd and changes no verdict

    @property
    def passed(self) -> bool:
        """Whether the verdict is "pass"."""
        return self.verdict == "pass"

    @property
    def closed(self) -> bool:
        """Whether there are no open edges."""
        return self.open_edges == 0

    @property
    def genus(self) -> int | None:
        """The sum of the components' genera; None unless all are orientable manifolds."""
        genera = [each.genus for each in self.components if each.orientable and each.genus is not None]
        return sum(genera) if len(genera) == len(self.components) else None

    def to_json(self) -> dict:
        """Return a JSON-able dict of all fields and `genus`."""
        return asdict(self) | {"genus": self.genus}


def certify_mesh(
    mesh: Mesh, *, with_boundary: bool | None = False, progress: Callable[[str], None] | None = None
) -> Certificate:
    """Return the Certificate of a Mesh (load it with `welded=False` to have its own indexing reported).

    with_boundary: certify a surface with boundary as such, instead of failing its open edges; None: only
    where open edges are all that is wrong. progress: called with the name of each stage as it begins. Raises
    InputError when nothing is left after the weld, and as `check_arrays` does.
    """
    if not isinstance(mesh, Mesh):
        raise InputError(f"a {type(mesh).__name__} is no Mesh; make one by `mesh.checked_mesh`")
    name, stage = mesh.name, progress or (lambda name: None)
    vertices, faces = check_arrays(mesh.vertices, mesh.faces, name)
    stage("weld")
    welded, indexed = weld(vertices, faces)
    if len(indexed) == 0:
        raise InputError(f"{name} has no triangle with three different corners; give a mesh with a surface")
    check_scale(welded, name)
    stage("edges")
    simplices = make_complex(indexed, len(welded))
    stage("manifold checks")
    checks = check_surface(welded, indexed, simplices.component_of_vertex)
    stage("exact homology")
    betti, counts = betti_numbers(simplices), simplices.counts()
    components = [_component(row, checks, i, betti[i]) for i, row in enumerate(counts.tolist())]
    total = _triple(betti.sum(axis=0))
    numbers = {name: int(getattr(checks, name).sum()) for name in FAULTS}
    euler = int(counts[:, 0].sum() - counts[:, 1].sum() + counts[:, 2].sum())
    if with_boundary is None:
        others = _reasons(numbers, checks, components, with_boundary=True)
        with_boundary = numbers["open_edges"] > 0 and not others
    reasons = _reasons(numbers, checks, components, with_boundary)
    return Certificate(
        name=name,
        vertices_as_indexed=len(vertices),
        faces_as_indexed=len(faces),
        open_edges_as_indexed=open_edge_count(faces, len(vertices)),
        vertices=len(welded),
        edges=len(simplices.edges),
        faces=len(indexed),
        collapsed_faces=len(faces) - len(indexed),
        duplicate_faces=int(checks.duplicate_faces.sum()),
        flat_faces=checks.flat_faces,
        **numbers,
        orientable=bool(checks.orientable.all()),
        euler=euler,
        euler_as_given=euler + int(checks.duplicate_faces.sum()),
        betti=total,
        components=tuple(sorted(components, key=lambda each: -each.faces)),
        kind=_kind(components),
        with_boundary=with_boundary,
        verdict="fail" if reasons else "pass",
        reasons=tuple(reasons),
        notes=tuple(_notes(checks, components, len(faces) - len(indexed)) + _apart(welded, indexed)),
    )


def _component(counts: list[int], checks: SurfaceChecks, i: int, betti: np.ndarray) -> Component:
    vertices, edges, faces = counts
    euler = vertices - edges + faces
    numbers = {name: int(getattr(checks, name)[i]) for name in FAULTS}
    orientable, loops = bool(checks.orientable[i]), numbers["boundary_loops"]
    genus = expected = None
    # A face given twice closes its own edges by count alone: what it bounds is no surface.
    if numbers["nonmanifold_edges"] == numbers["pinched_vertices"] == checks.duplicate_faces[i] == 0:
        crosscaps = 2 - euler - loops
        genus = crosscaps // 2 if orientable else crosscaps
        expected = (1, 2 - euler, 1) if loops == 0 else (1, 1 - euler, 0)
    whole = expected is not None and loops == 0 and orientable and numbers["reversed_edges"] == 0
    return Component(
        vertices=vertices,
        edges=edges,
        faces=faces,
        euler=euler,
        betti=_triple(betti),
        expected=expected,
        **numbers,
        orientable=orientable,
        genus=genus,
        volume=float(checks.volume[i]) if whole else None,
    )


def _triple(numbers: np.ndarray) -> tuple[int, int, int]:
    first, second, third = map(int, numbers)
    return first, second, third


def _reasons(
    numbers: dict[str, int], checks: SurfaceChecks, components: list[Component], with_boundary: bool
) -> list[str]:
    loops = _count(numbers["boundary_loops"], "boundary loop")
    crowded = _count(numbers["nonmanifold_edges"], "edge")
    pinched = _count(numbers["pinched_vertices"], "pinched vertex", "pinched vertices")
    repeated, twisted = int(checks.duplicate_faces.sum()), int((~checks.orientable).sum())
    odd = [
        each.euler
        for each, times in zip(components, checks.duplicate_faces, strict=True)
        if each.euler % 2 and each.open_edges == 0 and not times
    ]
    unlike = any(
        each.euler != each.betti[0] - each.betti[1] + each.betti[2] or each.expected not in (None, each.betti)
        for each in components
    )
    reasons = [
        (
            numbers["open_edges"] and not with_boundary,
            f"{_count(numbers['open_edges'], 'open edge')} in {loops}",
        ),
        (numbers["nonmanifold_edges"], f"non-manifold: {crowded} with more than two faces"),
        (numbers["pinched_vertices"], f"{pinched} (faces in more than one fan)"),
        (repeated, _count(repeated, "duplicate face")),
        (odd, f"odd Euler characteristic χ = {', '.join(map(str, odd[:4]))} of a component without boundary"),
        (twisted, f"not orientable ({_count(twisted, 'component')})"),
        (
            numbers["reversed_edges"] and not twisted,
            f"inconsistent winding at {_count(numbers['reversed_edges'], 'edge')}",
        ),
        (
            unlike,
            "homology and Euler characteristic disagree: "
            "please report this mesh, it is a fault of the certificate",
        ),
    ]
    return [text for holds, text in reasons if holds]


def _notes(checks: SurfaceChecks, components: list[Component], collapsed: int) -> list[str]:
    notes = []
    if collapsed:
        notes.append(f"{_count(collapsed, 'face')} dropped by the weld: two corners are one point")
    if checks.flat_faces:
        notes.append(f"{_count(checks.flat_faces, 'face')} of zero area")
    inward = sum(1 for each in components if each.volume is not None and each.volume < 0)
    if inward:
        notes.append(
            f"{inward} of {_count(len(components), 'component')} wound inwards (negative volume; "
            "a cavity's wall is, a body's should not be)"
        )
    return notes


def _apart(vertices: np.ndarray, faces: np.ndarray) -> list[str]:
    """Return a note where open edges come from points that a writer has rounded apart, nothing elsewhere."""
    edges, face_edges = edges_of(faces, len(vertices))
    ends = np.unique(edges[np.bincount(face_edges.reshape(-1)) == 1])
    if len(ends) < 2:
        return []
    most = NEAR * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    points = vertices[ends]
    distance, other = cKDTree(points).query(points, k=min(8, len(ends)), distance_upper_bound=most)
    one, place = np.nonzero(np.isfinite(distance[:, 1:]))
    labels = labels_of_graph(ends[one], ends[other[one, place + 1]], len(vertices))
    before, after = open_edge_count(faces, len(vertices)), open_edge_count(labels[faces], len(vertices))
    if after >= before:
        return []
    apart = distance[one, place + 1].max()
    return [
        f"{_count(len(np.unique(one)), 'point')} on open edges within {apart:.1e} of another, as rounding "
        f"leaves them; with such points merged {after} of {before} edges would be open: merge by "
        "distance (in Blender: Mesh, Merge, By Distance) and certify again"
    ]


def _kind(components: list[Component]) -> str:
    """Return what the mesh is: of one component its surface, of several how many of which sort."""
    sorts: dict[str, int] = {}
    for each in components:
        sorts[_sort_of(each)] = sorts.get(_sort_of(each), 0) + 1
    return "; ".join(f"{number} × {sort}" if len(components) > 1 else sort for sort, number in sorts.items())


def _sort_of(each: Component) -> str:
    if not each.manifold:
        return "no manifold" if each.nonmanifold_edges or each.pinched_vertices else "triangle given twice"
    handles = (
        f"genus {each.genus}" if each.orientable else f"not orientable, {_count(each.genus or 0, 'crosscap')}"
    )
    if each.boundary_loops == 0:
        return f"closed surface, {handles}"
    if each.genus == 0 and each.orientable:
        return {1: "disk", 2: "annulus"}.get(each.boundary_loops, f"sphere with {each.boundary_loops} holes")
    return f"surface with {_count(each.boundary_loops, 'boundary loop')}, {handles}"


def _count(number: int, singular: str, plural: str | None = None) -> str:
    return f"{number} {singular if number == 1 else plural or singular + 's'}"


def verdict_text(certificate: Certificate) -> str:
    """Return the verdict in a few words: PASS, PASS as a surface with boundary (how open), or FAIL."""
    if not certificate.passed or certificate.closed:
        return certificate.verdict.upper()
    loops = _count(certificate.boundary_loops, "boundary loop")
    return f"PASS as a surface with boundary ({loops}; not closed)"


def certificate_text(certificate: Certificate) -> str:
    """Return the certificate as lines of text, the verdict first."""
    c = certificate
    lines = [f"{c.name}: {verdict_text(c)}"]
    lines += [f"  reason: {reason}" for reason in c.reasons] + [f"  note: {note}" for note in c.notes]
    indexed = f"{c.vertices_as_indexed} vertices, {c.faces_as_indexed} triangles"
    loops = f" in {c.boundary_loops} boundary loops" if c.open_edges else ""
    winding = "orientable" if c.orientable else "not orientable"
    repeated = f" ({c.euler_as_given} with repeated faces)" if c.euler != c.euler_as_given else ""
    genus = "" if c.genus is None else f", total genus {c.genus}"
    rows = {
        "kind": c.kind,
        "as indexed": f"{indexed}, {c.open_edges_as_indexed} open edges",
        "after exact weld": f"{c.vertices} vertices, {c.edges} edges, {c.faces} triangles",
        "open edges": f"{c.open_edges}{loops}",
        "non-manifold": f"{c.nonmanifold_edges} edges, {c.pinched_vertices} pinched vertices",
        "winding": f"{winding}, {c.reversed_edges} edges wound alike by both faces",
        "components": f"{len(c.components)}{genus}",
        "Betti numbers, Z/2": f"{c.betti}",
        "Euler characteristic": f"{c.euler}{repeated}",
    }
    lines += [f"  {label:<21}{text}" for label, text in rows.items()]
    lines.append(
        f"  {'component':<11}{'vertices':>9}{'triangles':>10}{'χ':>6}  {'Betti':<14}{'expected':<14}"
        f"{'open':>5}{'loops':>6}{'genus':>6}"
    )
    for number, each in enumerate(c.components[:LONGEST], start=1):
        lines.append(
            f"  {number:<11}{each.vertices:>9}{each.faces:>10}{each.euler:>6}  {str(each.betti):<14}"
            f"{_or_dash(each.expected):<14}{each.open_edges:>5}{each.boundary_loops:>6}{_or_dash(each.genus):>6}"
        )
    if len(c.components) > LONGEST:
        lines.append(f"  … and {len(c.components) - LONGEST} smaller components (all of them in --json)")
    return "\n".join(lines)


def _or_dash(value: object) -> str:
    return "-" if value is None else str(value)
