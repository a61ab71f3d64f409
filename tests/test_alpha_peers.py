"""Facts of the kinds that the suites of gudhi, persim and torch-topological check, with values by hand or by
theorem; and the programs of docs/persistence.md."""

from itertools import combinations

import numpy as np
import pytest
import torch
from scipy.spatial.distance import directed_hausdorff
from scipy.stats import special_ortho_group

from paper_artifact.alpha import (
    alpha_filtration,
    alpha_persistence,
    bottleneck,
    persistence_image,
    persistence_landscape,
    wasserstein,
)
from paper_artifact.files import REPOSITORY
from tests.test_alpha_face import CORNER, cloud
from tests.test_alpha_pairs import CLOUDS
from tests.test_readme import blocks

PROGRAMS = blocks("python", (REPOSITORY / "docs" / "persistence.md").read_text(encoding="utf-8"))
NONE = np.empty((0, 2))


@pytest.mark.parametrize("program", PROGRAMS, ids=[str(i) for i in range(len(PROGRAMS))])
def test_programs_of_the_page_run_and_print_what_their_comments_say(program, capsys):
    import matplotlib.pyplot as plt

    names: dict = {}
    exec(compile(program, "docs/persistence.md", "exec"), names)
    printed = capsys.readouterr().out
    for line in program.splitlines():
        if line.startswith("print(") and "  # " in line:
            assert line.rsplit("  # ", 1)[1] in printed
    assert "history" not in names or names["history"][-1] < 2 * names["history"][0] < 0
    assert "distances" not in names or names["distances"][-1] < 0.5 * names["distances"][0]
    plt.close("all")


# complexes


@pytest.mark.parametrize(
    ("points", "counts", "radii"),
    [
        ([[0, 0], [2, 0], [0, 2], [2, 2]], (4, 5, 2), [0] * 4 + [1] * 4 + [2**0.5] * 3),
        ([[0, 0, 0], [4, 0, 0], [0, 3, 0]], (3, 3, 1, 0), [0] * 3 + [1.5, 2, 2.5, 2.5]),
        ([[0, 0], [6, 0], [3, 1]], (3, 3, 1), [0] * 3 + [10**0.5 / 2] * 2 + [5, 5]),
        ([[0], [1], [3]] * np.array([[1, 2, 2]]), (3, 2, 0, 0), [0] * 3 + [1.5, 3]),
        ([[5, 5, 5]] * 4, (1, 0, 0, 0), [0]),
    ],
    ids=["square", "right triangle", "obtuse triangle", "line", "point"],
)
def test_small_complexes_have_the_simplices_and_radii_found_by_hand(points, counts, radii):
    found = alpha_filtration(np.array(points, dtype=float))
    assert tuple(map(len, found.simplices)) == counts
    np.testing.assert_allclose(np.sort(np.concatenate(found.radii)), np.sort(radii), rtol=1e-15)


def test_known_shapes_have_their_bars():
    angle = 2 * np.pi * np.arange(12) / 12
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    components, loops = alpha_persistence(circle, infinite=True)
    np.testing.assert_allclose(components.deaths, [np.sin(np.pi / 12)] * 11 + [np.inf], rtol=1e-14)
    np.testing.assert_allclose(loops.diagram, [[np.sin(np.pi / 12), 1.0]], rtol=1e-14)
    octahedron = alpha_persistence(np.vstack([np.eye(3), -np.eye(3)]))
    np.testing.assert_allclose(octahedron[2].diagram, [[(2 / 3) ** 0.5, 1.0]], rtol=1e-14)
    two = alpha_persistence(np.vstack([circle, circle + [10, 0]]), infinite=True, max_radius=0.9)
    assert [np.isinf(each.deaths).sum() for each in two] == [2, 2]


@pytest.mark.parametrize(
    "name", ["uniform", "torus", "soup of 5", "integer lattice", "coplanar", "collinear"]
)
def test_every_filtration_is_monotone_a_ball_at_the_end_and_counts_its_bars(name):
    points = np.asarray(CLOUDS[name](), dtype=float)[:300]
    found, bars = alpha_filtration(points), alpha_persistence(points, infinite=True)
    assert sum((-1) ** d * len(each) for d, each in enumerate(found.radii)) == 1  # Euler: contractible
    value: dict = {}
    for simplices, radii in zip(found.simplices, found.radii, strict=True):
        value |= zip(map(tuple, simplices.tolist()), radii, strict=True)
    for simplex, radius in value.items():
        assert all(value[face] <= radius for face in combinations(simplex, len(simplex) - 1) if face)
    for radius in np.quantile(np.concatenate(found.radii), [0.3, 0.6, 0.9]) * (1 + 1e-9):  # Euler-Poincaré
        chi = sum((-1) ** d * (each <= radius).sum() for d, each in enumerate(found.radii))
        alive = [((each.births <= radius) & (each.deaths > radius)).sum() for each in bars]
        assert chi == sum((-1) ** d * count for d, count in enumerate(alive))


def test_motions_keep_the_bars_and_noise_moves_them_by_no_more_than_itself():
    points = cloud(200)
    moved = points @ special_ortho_group(3, seed=1).rvs().T + [3.0, -2.0, 1.0]
    noisy = points + 0.01 * cloud(200, name="noise")
    hausdorff = max(directed_hausdorff(points, noisy)[0], directed_hausdorff(noisy, points)[0])
    clouds = points, moved, points[:, [1, 0, 2]] * [1, -1, 1], noisy
    for bars, same, mirrored, near in zip(*map(alpha_persistence, clouds), strict=True):
        assert bottleneck(bars, same) < 1e-13 and bottleneck(bars, mirrored) < 1e-13
        assert 0 < bottleneck(bars, near) <= hausdorff  # stability theorem


# distances, images, landscapes


@pytest.mark.parametrize(
    ("a", "b", "order", "internal", "bottle", "wasser"),
    [
        ([[1, 3]], [[1, 4]], 1, np.inf, 1, 1),
        ([[1, 3], [2, 8]], [[2, 9]], 1, np.inf, 1, 2),
        ([[0, 6], [0, 6]], [[0, 6]], 1, 2, 3, 3 * 2**0.5),  # one of two equal bars is alone
        ([[0, 10]], [[5, 5]], 1, np.inf, 5, 5),  # a bar of no length is nothing
        ([[7, 7]], NONE, 2, 2, 0, 0),
        ([[5, 9], [5, 8]], [[3, 10], [8, 9]], 1, np.inf, 2, 4),
        ([[0, 6], [1, 9]], NONE, 2, 1, 4, 10),
        ([[0, 6], [1, 9]], NONE, 2, np.inf, 4, 5),  # 3² + 4²
        ([[0, 3], [5, 9]], [[0, 6], [5, 13]], 2, 4.5, 4, 5),
        ([[0, 2], [4, np.inf]], [[1, np.inf], [6, 7]], 1, np.inf, 3, 4.5),
        ([[0, np.inf], [3, np.inf]], [[2, np.inf], [0, np.inf]], 2, np.inf, 1, 1),
        ([[0, np.inf]], NONE, 1, np.inf, np.inf, np.inf),
        ([[0, 2]], [[0, 1.2]], 1, np.inf, 0.8, 0.8),  # cheaper than half lives of 1 and .6
        (NONE, NONE, 1, np.inf, 0, 0),
    ],
)  # fmt: skip
def test_distances_by_hand(a, b, order, internal, bottle, wasser):
    a, b = np.array(a, dtype=float), np.array(b, dtype=float)
    for x, y in ((a, b), (b, a), (a[::-1], b)):
        assert bottleneck(x, y) == pytest.approx(bottle, rel=1e-15)
        assert wasserstein(x, y, order, internal) == pytest.approx(wasser, rel=1e-14)
        tensors = torch.tensor(x.copy()), torch.tensor(y.copy())
        assert float(wasserstein(*tensors, order, internal)) == pytest.approx(wasser)


def test_distances_take_lists_empty_ones_and_pairs():
    assert bottleneck([[0, np.inf]], []) == wasserstein([[0, np.inf]], [[0, 1]]) == np.inf
    pairs = alpha_persistence(CORNER, infinite=True)[0]
    assert bottleneck(pairs, [[0, np.inf]]) == pytest.approx(0.75)


def test_landscapes_and_images_by_hand():
    layers = persistence_landscape([[1, 5], [3, 9]], 2, 11, (0, 10))
    expected = [0, 0, 1, 2, 1, 2, 3, 2, 1, 0, 0], [0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]
    np.testing.assert_array_equal(layers, expected)
    span = ((0.0, 4.0), (0.0, 8.0))
    image = persistence_image([[1, 3]], 4, 0.5, span)
    assert image.shape == (4, 4) and image.argmax() in (0, 1, 4, 5)
    peak = persistence_image([[0.5, 1.5]], 4, 0.5, span)[0, 0]  # the pixel's centre is (.5, 1): lifetime 1
    assert peak == pytest.approx(1 / (2 * np.pi * 0.25))
    both = persistence_image([[1, 3], [2, 8]], 4, 0.5, span)
    np.testing.assert_allclose(both, image + persistence_image([[2.0, 8.0]], 4, 0.5, span), rtol=1e-14)
    np.testing.assert_array_equal(image, persistence_image([[1.0, 3.0], [2, np.inf]], 4, 0.5, span))
