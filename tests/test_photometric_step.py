"""The trainer's CPU step against the double-precision twin: values, finite differences, expectation."""

from typing import NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from paper_artifact.randomness import stream
from paper_artifact.raster import twin
from paper_artifact.raster.arrays import SoupArrays
from paper_artifact.raster.draws import view_key
from paper_artifact.raster.photometric import make_target
from paper_artifact.raster.threads import one_torch_thread
from paper_artifact.raster.view import PhotometricStep, ViewRaster, make_camera, to_clip
from paper_artifact.scene.build import SceneConfig, build_scene
from paper_artifact.scene.cameras import CAMERA_DISTANCE, FAR, NEAR
from paper_artifact.scene.load import Scene, load_scene
from paper_artifact.scene.shapes import make_shape
from paper_artifact.soup.state import Soup
from paper_artifact.train.backend import CpuBackend
from paper_artifact.train.loop import train
from tests.raster_cases import BACKGROUND, cameras, distance, doubles, soup_arrays
from tests.tiny_run import STEPS, tiny_config

HEIGHT, WIDTH, BATCH = 45, 62, 3
NAMES = ("vertices", "features", "opacity", "w1", "c1", "w2", "c2", "w3", "c3")


class Case(NamedTuple):
    """A soup before targets, with everything that both paths take."""

    soup: SoupArrays
    matrices: np.ndarray  # (B,4,4) float32
    images: np.ndarray  # (B,3,H,W) float32
    keys: list[int]

    def step(self, step: PhotometricStep | None = None) -> tuple[float, SoupArrays]:
        """Return the loss and its gradients by the kernels."""
        step = step or PhotometricStep(*self.images.shape[2:], BACKGROUND)
        targets = [make_target(image) for image in self.images]
        return step(self.soup, [make_camera(matrix) for matrix in self.matrices], targets, self.keys)

    def raster(self) -> twin.Raster:
        """Return what the twin sees."""
        vertices, _, opacity, *_ = doubles(self.soup)
        matrices = torch.from_numpy(self.matrices).double()
        return twin.rasterize(vertices, opacity, matrices, *self.images.shape[2:], self.keys)

    def flips(self) -> int:
        """Return the number of pixels where rounding lets another triangle win than in the twin."""
        seen = self.raster().triangle.numpy()
        view, count = ViewRaster(*self.images.shape[2:]), 0
        for index, matrix in enumerate(self.matrices):
            view.draw(to_clip(self.soup.vertices, matrix), self.soup.opacity, self.keys[index])
            count += int((view.seen() != seen[index]).sum())
        return count

    def twin_loss(self, leaves: list[torch.Tensor], raster: twin.Raster) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the twin's loss and the term of value 0 that carries the opacity gradient."""
        vertices, features, opacity, *weights = leaves
        matrices, images = torch.from_numpy(self.matrices).double(), torch.from_numpy(self.images).double()
        background = torch.from_numpy(BACKGROUND).double()
        colour = twin.shade(features, tuple(weights), raster, matrices, background)
        auxiliary = twin.opacity_gradient(opacity, colour.detach(), images, raster)
        colour = twin.edge_gradient(colour, vertices, raster, matrices)
        return twin.photometric_loss(colour, images), auxiliary


def make_case(
    seed: int = 3, triangles: int = 60, size: tuple[int, int] = (HEIGHT, WIDTH), views: int = BATCH
) -> Case:
    images = stream(seed, "photometric step targets").integers(0, 256, (views, 3, *size)) / np.float32(255)
    images = images.astype(np.float32)
    matrices = cameras(seed, views).numpy().astype(np.float32)
    keys = [view_key(seed, 5, index) for index in range(views)]
    return Case(soup_arrays(seed, triangles, size=0.5), matrices, images, keys)


@pytest.fixture(scope="module")
def case() -> Case:
    return make_case()


def check_against_twin(case: Case) -> None:
    loss, gradients = case.step()
    leaves = [leaf.requires_grad_() for leaf in doubles(case.soup)]
    expected, auxiliary = case.twin_loss(leaves, case.raster())
    (expected + auxiliary).backward()
    assert loss == pytest.approx(expected.item(), rel=1e-5)
    for name, gradient, leaf in zip(NAMES, gradients.flat(), leaves, strict=True):
        assert gradient.dtype == np.float32
        assert distance(gradient, leaf.grad) < (1e-4 if name == "vertices" else 1e-5), name


@settings(max_examples=15, deadline=None, derandomize=True, database=None)
@example(seed=107, triangles=60, height=HEIGHT, width=WIDTH, views=BATCH)
@example(seed=90, triangles=60, height=23, width=67, views=BATCH)
@example(seed=89, triangles=60, height=67, width=22, views=BATCH)
@given(
    seed=st.integers(10, 10**6),
    triangles=st.integers(5, 200),
    height=st.integers(22, 67),
    width=st.integers(22, 67),
    views=st.integers(1, 4),
)
def test_any_soup_at_any_size_has_the_twins_loss_and_gradients(seed, triangles, height, width, views):
    case = make_case(seed, triangles, (height, width), views)
    assume(case.flips() == 0)
    check_against_twin(case)


def test_a_triangle_whose_plane_has_w_infinite_in_the_image_has_the_twins_gradients():
    """1/w is 1 - column/8 on the triangle's plane: exactly 0 at column 8, right of its last corner at column
    4."""
    size, columns, rows, w = (16, 16), np.array([0, 4, 0]), np.array([0, 0, 4]), np.array([1.0, 2.0, 1.0])
    corners = np.stack([((2 * columns + 1) / 16 - 1) * w, ((2 * rows + 1) / 16 - 1) * w, w], axis=-1)
    matrix = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1.5, -1.25], [0, 0, 1, 0]], np.float32)
    far = np.array([[-9.0, -9.0, 2.25], [9.0, -9.0, 2.25], [0.0, 18.0, 2.25]])
    soup = soup_arrays(1, 2)._replace(vertices=np.stack([corners, far]).astype(np.float32))
    images = stream(1, "photometric step targets").random((1, 3, *size), dtype=np.float32)
    for key in range(4):
        case = Case(soup, matrix[None], images, [view_key(1, key, 0)])
        assert case.flips() == 0
        check_against_twin(case)


@one_torch_thread()
def test_the_edge_gradient_of_a_trained_soup_is_the_twins_where_float32_depths_decide_alike(tmp_path):
    """A trained surface is sheets that all but touch. Which lies in front, and whether two cross between two
    pixels, hangs there on the last bits of NDC depth, and such a crossing pulls with 1 / (difference of the
    slopes). Those few triangles are found by the twin alone: corners moved by what float32 depths do not
    resolve change its own gradient."""
    build_scene(make_shape("torus"), SceneConfig(views=8, size=64, points=2000), tmp_path / "scene")
    scene = load_scene(tmp_path / "scene")
    soup = train(scene, tiny_config(dump_steps=()), device="cpu").soup.drawn()
    views = scene.train[:4]
    images = scene.images[views] / np.float32(255)
    case = Case(soup, scene.world_to_clip[views], images, [view_key(0, STEPS + 1, int(v)) for v in views])
    found, view, states = np.zeros_like(soup.vertices), ViewRaster(64, 64), []
    for matrix, image, key in zip(case.matrices, case.images, case.keys, strict=True):
        view.render(soup, make_camera(matrix), scene.background, key)
        view.compare(make_target(image), len(views))
        view.add_edge_gradient(matrix, found)
        depth = view.surface.depth[: 64 * 64].reshape(64, 64)
        states.append([each.copy() for each in (view.seen(), depth, view.colour, view.gradient)])
    triangle, depth, colour, gradient = (
        torch.from_numpy(np.stack(each)) for each in zip(*states, strict=True)
    )
    seen = case.raster()._replace(
        triangle=triangle.long(), depth=torch.where(triangle > 0, depth, 0.0).double()
    )  # the kernel's own: only the edges are compared
    matrices = torch.from_numpy(case.matrices).double()

    def edges(vertices: torch.Tensor) -> np.ndarray:
        leaf = vertices.clone().requires_grad_()
        twin.edge_gradient(colour.double(), leaf, seen, matrices).backward(gradient.double())
        return leaf.grad.numpy()

    def sizes(values: np.ndarray) -> np.ndarray:
        return np.linalg.norm(values.reshape(len(values), -1), axis=1)

    vertices = torch.from_numpy(soup.vertices).double()
    expected = edges(vertices)
    # Two steps of float32 below 1 in NDC depth z = (far+near - 2 far near / w) / (far-near), as a length.
    w = CAMERA_DISTANCE * scene.radius
    step = 2 * 2**-24 * w**2 * (FAR - NEAR) / (2 * FAR * NEAR * scene.radius)
    draws = stream(8, "what float32 depths do not resolve")
    moves = [torch.from_numpy(draws.uniform(-step, step, vertices.shape)) for _ in range(6)]
    moved = np.max([sizes(edges(vertices + move) - expected) for move in moves], axis=0)
    off, norm = sizes(found - expected), np.linalg.norm(expected)
    steady = moved < 1e-3 * norm
    assert np.mean(steady) > 0.95
    assert np.linalg.norm(off[steady]) < 1e-4 * np.linalg.norm(expected[steady])
    assert (off <= moved + 1e-5 * norm).all()  # and the others are off by no more than that


def flat_soup(vertices: np.ndarray, colours: np.ndarray, opacity: np.ndarray) -> SoupArrays:
    """Return triangles of one colour each (blend 0 leaves the MLP out): (T,3,3), (T,3) and (T,3)."""
    soup = soup_arrays(0, len(vertices))
    features = np.zeros_like(soup.features)
    features[..., :3] = colours[:, None]
    return soup._replace(
        vertices=vertices.astype(np.float32), features=features, opacity=opacity.astype(np.float32)
    )


def test_opacity_gradients_are_on_average_the_finite_differences_of_the_expected_error():
    """Over the draws, mean |colour - target| is a sum over fragments of the chance that each is the one seen.

    Its derivative by central differences, in float64, is what the masking gradient must give on average.
    """
    size, repetitions = (22, 23), 600
    draws = stream(6, "masking gradient")
    colours, opacity = draws.random((6, 3)), draws.uniform(0.2, 0.8, (6, 3))
    soup = flat_soup(soup_arrays(6, 6, size=1.2).vertices, colours, opacity)
    matrix, image = cameras(6, 1).numpy().astype(np.float32), draws.random((1, 3, *size), dtype=np.float32)
    case = Case(soup, matrix, image, [0])
    raster = case.raster()
    order = torch.argsort(raster.fragment_depth).tolist()
    pixels, triangles = raster.fragment_pixel.tolist(), raster.fragment_triangle.tolist()
    b0, b1 = raster.fragment_b0.numpy(), raster.fragment_b1.numpy()
    wanted = image[0].reshape(3, -1).T.astype(np.float64)
    colours = soup.features[:, 0, :3].astype(np.float64)

    def expected_error(opacity: np.ndarray) -> float:
        unseen, total = np.ones(len(wanted)), 0.0
        for fragment in order:
            pixel, triangle = pixels[fragment], triangles[fragment]
            weights = (b0[fragment], b1[fragment], 1 - b0[fragment] - b1[fragment])
            alpha = float(weights @ opacity[triangle])
            total += unseen[pixel] * alpha * np.abs(colours[triangle] - wanted[pixel]).sum()
            unseen[pixel] *= 1 - alpha
        total += float(unseen @ np.abs(BACKGROUND - wanted).sum(1))
        return total / wanted.size

    step = PhotometricStep(*size, BACKGROUND)
    found = np.stack(
        [case._replace(keys=[view_key(1, k, 0)]).step(step)[1].opacity for k in range(repetitions)]
    ).astype(np.float64)
    value, error = found.mean(0), found.std(0) / np.sqrt(repetitions)
    expected, base = np.zeros((6, 3)), soup.opacity.astype(np.float64)
    for index in np.ndindex(6, 3):
        shift = np.zeros((6, 3))
        shift[index] = 1e-4
        expected[index] = (expected_error(base + shift) - expected_error(base - shift)) / 2e-4
    assert np.abs(expected).max() > 10 * error.max()
    assert (np.abs(value - expected) <= 5 * error + 1e-9).all()
    assert (value * expected).sum() / (expected**2).sum() == pytest.approx(1, abs=0.06)


def test_a_step_is_its_stages_one_after_another(case):
    loss, gradients = case.step()
    losses, parts = [], []
    for matrix, image, key in zip(case.matrices, case.images, case.keys, strict=True):
        view, camera, target = ViewRaster(HEIGHT, WIDTH), make_camera(matrix), make_target(image)
        out = SoupArrays.of(np.zeros_like(array) for array in case.soup.flat())
        view.render(case.soup, camera, BACKGROUND, key)
        losses.append(view.compare(target, BATCH))
        view.add_shading_gradient(case.soup, camera.rays, out.features, out.mlp)
        view.add_edge_gradient(matrix, out.vertices)
        view.add_opacity_gradient(BATCH, out.opacity)
        parts.append(out.flat())
    assert loss == sum(losses)
    for name, gradient, views in zip(NAMES, gradients.flat(), zip(*parts, strict=True), strict=True):
        assert np.abs(gradient).max() > 0 and np.array_equal(gradient, np.stack(views).sum(0)), name


def test_a_step_object_keeps_nothing_from_one_call_to_the_next(case):
    step = PhotometricStep(HEIGHT, WIDTH, BACKGROUND)
    first = case.step(step)
    make_case(triangles=9).step(step)
    make_case(triangles=90, views=1).step(step)
    (loss, gradients), (again, others) = first, case.step(step)
    assert loss == again and all(map(np.array_equal, gradients.flat(), others.flat()))


def backend_of(case: Case) -> CpuBackend:
    """Return the backend of a scene of four views; the case's three, in their order, are views 3, 0 and 2."""
    order = [3, 0, 2]
    images, matrices = np.zeros((4, 3, HEIGHT, WIDTH), np.uint8), np.tile(case.matrices[:1], (4, 1, 1))
    images[order], matrices[order] = np.rint(255 * case.images), case.matrices
    fields = {"images": images, "world_to_clip": matrices, "background": BACKGROUND}
    scene = Scene(**{name: fields.get(name) for name in Scene.__dataclass_fields__})
    return CpuBackend(scene, np.array([0, 2, 3]))


def test_the_cpu_backend_sets_the_soups_gradients(case):
    vertices, features, opacity, *weights = (torch.from_numpy(array) for array in case.soup.flat())
    soup = Soup(vertices, torch.logit(features), torch.logit(opacity), tuple(weights)).trainable()
    tensors = (soup.vertices, soup.features, soup.opacity, *soup.mlp)
    loss = backend_of(case).photometric_step(soup, np.array([3, 0, 2]), case.keys)
    expected_loss, gradients = case._replace(soup=soup.drawn()).step()
    assert loss == expected_loss
    for name, tensor, array in zip(NAMES, tensors, gradients.flat(), strict=True):
        gradient = torch.from_numpy(array)
        if name in ("features", "opacity"):  # the sigmoid's derivative is formed in another order
            drawn = torch.sigmoid(tensor.detach())
            gradient = gradient * drawn * (1 - drawn)
            close = {"rtol": 1e-6, "atol": 1e-6 * float(gradient.abs().max())}
            torch.testing.assert_close(tensor.grad, gradient, **close)
        else:
            assert torch.equal(tensor.grad, gradient), name
