"""alpha_persistence against gudhi's exact path, degenerate clouds, and the parts that it is made of."""

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from paper_artifact.alpha import alpha_filtration, circumradius, delaunay, ordering
from paper_artifact.alpha.persistence import Pairs, alpha_persistence, gudhi_persistence
from paper_artifact.randomness import stream


def draw(name: str) -> np.random.Generator:
    return stream(0, f"test persistence {name}")


def sphere(n: int) -> np.ndarray:
    x = draw("sphere").normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1)[:, None]


def torus(n: int) -> np.ndarray:
    a, b = draw("torus").random((2, n)) * 2 * np.pi
    ring = 1 + 0.4 * np.cos(b)
    return np.column_stack([ring * np.cos(a), ring * np.sin(a), 0.4 * np.sin(b)])


def cube_surface(n: int) -> np.ndarray:
    rng = draw("cube")
    points = rng.random((n, 3))
    points[np.arange(n), rng.integers(0, 3, n)] = rng.integers(0, 2, n)
    return points


def soup(n: int, triangles: int, size: float = 0.15) -> np.ndarray:
    """n samples on `triangles` random triangles near the unit sphere: many samples in one plane."""
    rng = draw("soup")
    corners = sphere(triangles)[:, None] + rng.normal(size=(triangles, 3, 3)) * size
    return np.einsum("nk,nkd->nd", rng.dirichlet([1, 1, 1], n), corners[rng.integers(0, triangles, n)])


def lattice(k: int, jitter: float = 0.0) -> np.ndarray:
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, k)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid + jitter * draw("lattice").normal(size=grid.shape)


def cylinder() -> np.ndarray:
    angle, height = np.tile(2 * np.pi * np.arange(48) / 48, 3), np.repeat([0.0, 0.5, 1.0], 48)
    return np.column_stack([np.cos(angle), np.sin(angle), height])


def outliers() -> np.ndarray:
    x = draw("outliers").normal(size=(420, 3))
    return np.concatenate([x[:200] * 1e-3, x[200:400] * 1e-3 + 5, x[400:] * 100])


def duplicates() -> np.ndarray:
    rng = draw("duplicates")
    return np.repeat(rng.random((200, 3)), 3, axis=0)[rng.permutation(600)]


CLOUDS = {
    "uniform": lambda: draw("uniform").random((1000, 3)),
    "sphere": lambda: sphere(500),
    "torus": lambda: torus(1000),
    "torus float32": lambda: torus(1000).astype(np.float32),
    "torus far away": lambda: torus(400) + 1e6,
    "cube surface": lambda: cube_surface(1000),
    "soup of 300": lambda: soup(2048, 300),
    "soup of 300 float32": lambda: soup(2048, 300).astype(np.float32),
    "soup of 5": lambda: soup(600, 5, 0.5),
    "soup of 2": lambda: soup(300, 2, 0.5),
    "one triangle": lambda: soup(200, 1, 0.5),
    "lattice": lambda: lattice(7),
    "integer lattice": lambda: np.round(6 * lattice(7)),
    "lattice jitter 1e-2": lambda: lattice(7, 1e-2),
    "lattice jitter 1e-6": lambda: lattice(7, 1e-6),
    "lattice jitter 1e-10": lambda: lattice(7, 1e-10),
    "icosphere": lambda: np.array(trimesh.creation.icosphere(2).vertices),
    "uv sphere": lambda: np.array(trimesh.creation.uv_sphere(count=[12, 12]).vertices),
    "cylinder": cylinder,
    "outliers": outliers,
    "duplicates": duplicates,
    "coplanar": lambda: np.column_stack([draw("plane").random((150, 2)), np.full(150, 0.25)]),
    "tilted plane": lambda: draw("tilted").random((150, 2)) @ np.array([[1.0, 0.3, -0.2], [0.1, 0.7, 0.9]]),
    "collinear": lambda: np.outer(np.arange(40.0), [1.0, 2.0, 3.0]),
    "one point many times": lambda: np.ones((30, 3)),
    "tiny unit": lambda: torus(300) * 1e-30,
    "huge unit": lambda: torus(300) * 1e30,
    "subnormal coordinates": lambda: np.where(cube_surface(200) == 0.0, 5e-324, cube_surface(200)),
}
CLOUDS |= {f"{n} points": lambda n=n: draw(f"few generic {n}").random((n, 3)) for n in range(8)}


def exact_pairs(points: np.ndarray) -> tuple[Pairs, ...]:
    """Return the oracle's: `safe` evaluates the radii of near-flat tetrahedra to 1e-5 only."""
    return gudhi_persistence(np.asarray(points, dtype=np.float64).reshape(-1, 3), precision="exact")


def gap(ours: np.ndarray, theirs: np.ndarray, scale: float) -> float:
    """Return the largest difference of two diagrams' bars longer than about 1e-8 of the scale."""
    # a cut in the middle of a gap between bar lengths, so that rounding cannot move a bar across it
    lengths = np.sort(np.concatenate([np.ptp(ours, 1), np.ptp(theirs, 1), [1e-9 * scale, 1e-8 * scale]]))
    window = lengths[(lengths >= 1e-9 * scale) & (lengths <= 1e-8 * scale)]
    widest = int(np.argmax(np.diff(window)))
    cut = (window[widest] + window[widest + 1]) / 2
    a, b = (np.sort(each[np.ptp(each, 1) > cut], axis=0) for each in (ours, theirs))
    assert len(a) == len(b)
    return float(np.abs(a - b).max(initial=0.0))


def check_against_gudhi(points: np.ndarray) -> None:
    scale = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    scale = scale or 1.0
    for ours, theirs in zip(alpha_persistence(points), exact_pairs(points), strict=True):
        assert gap(ours.diagram, theirs.diagram, scale) < 1e-9 * scale


@pytest.mark.parametrize("name", CLOUDS)
def test_fast_equals_gudhi(name):
    check_against_gudhi(np.asarray(CLOUDS[name](), dtype=np.float64))


@settings(max_examples=120, deadline=None)
@given(st.lists(st.tuples(*[st.integers(-2, 2)] * 3), max_size=24))
def test_degenerate_integer_clouds(rows):
    check_against_gudhi(np.array(rows, dtype=float).reshape(-1, 3))


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.integers(0, 1)), min_size=5, max_size=20),
    st.integers(30, 54),
)
def test_nearly_degenerate_clouds(rows, exponent):
    points = np.array(rows, dtype=float)
    check_against_gudhi(points + draw("nearly").integers(-1, 2, points.shape) * 2.0**-exponent)


@pytest.mark.parametrize("name", ["uniform", "torus", "soup of 300"])
def test_pairs_name_the_simplices_that_set_the_bars(name):
    points = CLOUDS[name]()
    points.setflags(write=False)
    theirs = alpha_persistence(points, "gudhi") if name == "soup of 300" else exact_pairs(points)
    for dimension, (pairs, other) in enumerate(zip(alpha_persistence(points), theirs, strict=True)):
        named = [pairs.birth_simplices, pairs.death_simplices]
        for more, simplices, values in zip((1, 2), named, pairs.diagram.T, strict=True):
            assert simplices.shape == (len(pairs), dimension + more) and simplices.dtype == np.int64
            assert (np.diff(simplices, axis=1) > 0).all()
            assert len(np.unique(simplices, axis=0)) == len(pairs)  # a matching
            long = np.ptp(pairs.diagram, axis=1) > 1e-6
            if dimension + more > 1:  # test_alpha_exact holds `circumradius` to a slow twin
                radii = circumradius(torch.from_numpy(points[simplices[long]]))
                np.testing.assert_allclose(radii, values[long], atol=1e-9)
        assert gap(pairs.diagram, other.diagram, 1.0) < 1e-9
        if name == "soup of 300":  # coplanar samples: which of two simplices of one value is a convention
            continue
        first = int(dimension == 0)  # so is which of two vertices of equal age dies
        rows = [
            {tuple(row) for row in np.hstack([each.birth_simplices, each.death_simplices][first:])}
            for each in (pairs, other)
        ]
        assert rows[0] == rows[1]


# the parts


@pytest.mark.parametrize("n", [4, 5, 30, 1500])
def test_triangulation_equals_scipys_on_generic_points(n):
    points = draw(f"delaunay {n}").random((n, 3))
    expected = {tuple(cell) for cell in np.sort(Delaunay(points).simplices, axis=1).tolist()}
    assert {tuple(cell) for cell in alpha_filtration(points).simplices[3].tolist()} == expected


def test_a_star_of_many_cells_grows_the_workspaces():
    """The centre comes last and sees every point: one huge cavity."""
    scaled, _ = ordering.normalised(np.vstack([sphere(3000), np.zeros((1, 3))]))
    order = np.arange(3001, dtype=np.int32)
    assert delaunay.first_simplex(scaled, order) == 4 and order[3000] == 3000
    mesh, _ = delaunay.triangulate(scaled)
    cells, _ = delaunay.finite_cells(mesh, np.arange(3001, dtype=np.int32))
    assert (cells == 3000).any(axis=1).sum() > 5000


def test_sort_keys_is_a_stable_sort():
    rng = draw("sort")
    for top, size in ((2**63, 5000), (9, 5000), (9, 0)):
        keys = rng.integers(0, top, size).astype(np.uint64)
        np.testing.assert_array_equal(ordering.sort_keys(keys), np.argsort(keys, kind="stable"))
    keys = np.append(keys, np.uint64(2**63))  # the others differ only far behind the first bit that differs
    keys = np.append(keys, rng.integers(0, 1000, 5000).astype(np.uint64))
    np.testing.assert_array_equal(ordering.sort_keys(keys), np.argsort(keys, kind="stable"))


def test_the_hilbert_curve_visits_every_cell_and_never_jumps():
    side = 8
    grid = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.full((1, 3), (1 << ordering.HILBERT_BITS) - 1)  # fixes the box: the cells are the grid's
    places = ordering.hilbert_indices(np.vstack([grid, corner]).astype(float))[:-1]
    assert sorted(places) == list(range(side**3))
    steps = np.abs(np.diff(grid[np.argsort(places)], axis=0)).sum(axis=1)
    assert (steps == 1).all()
