"""What is saved anew or removed while a command reads it is refused: nothing is named after one content and
made of another."""

import shutil

import numpy as np
import pytest
from PIL import Image

from paper_artifact import pipeline
from paper_artifact.catalogue import study_config
from paper_artifact.config import RunConfig
from paper_artifact.errors import InputError
from paper_artifact.photos import scene as photos_scene
from paper_artifact.photos.scene import photographs_scene
from paper_artifact.scene import transforms
from paper_artifact.scene.build import SceneConfig, build_scene
from paper_artifact.scene.shapes import make_shape
from paper_artifact.scene.transforms import TransformsConfig, transforms_scene
from tests.test_transforms import cameras, folder, torus  # noqa: F401  (fixtures)

pytestmark = pytest.mark.faults
SHORT = {"steps": 4, "budget": 60, "samples": 200, "dump_steps": (4,), "resample_every": 2}


def before(monkeypatch, module, name, change):
    """Let `change` run before the module's function of that name does."""
    function = getattr(module, name)

    def changed(*given, **named):
        change()
        return function(*given, **named)

    monkeypatch.setattr(module, name, changed)


@pytest.fixture
def own(tmp_path):
    """A scene's folder with photographs of a sphere and no ground truth."""
    place = build_scene(
        make_shape("sphere"), SceneConfig(views=9, size=44, supersample=2, points=300), tmp_path / "own"
    )
    (place / "scene.json").unlink()
    (place / "ground_truth.npz").unlink()
    return place


@pytest.mark.parametrize("again", [False, True])
def test_a_scene_that_is_saved_anew_gives_no_record_under_its_old_name(own, tmp_path, monkeypatch, again):
    results = tmp_path / "results"
    config = study_config(str(own), "C0", 0, **SHORT)
    assert isinstance(config, RunConfig)
    kept = [pipeline.run(config, results=results)] if again else []
    written = {path: path.read_bytes() for path in results.rglob("*.json")}

    def paint():
        Image.new("RGB", (44, 44), "red").save(sorted((own / "images").iterdir())[0])

    before(monkeypatch, pipeline, "load_scene", paint)
    with pytest.raises(InputError, match="own was saved anew while it was read; start again"):
        pipeline.run(config, results=results, again=again)
    assert len(kept) == len(written) == again
    assert {path: path.read_bytes() for path in results.rglob("*.json")} == written


@pytest.mark.parametrize("change", ["saved anew", "removed"])
def test_photographs_that_change_while_they_are_read_make_no_scene(tmp_path, monkeypatch, change):
    pytest.importorskip("pycolmap")
    (source := tmp_path / "photos").mkdir()
    draws = np.random.default_rng(0)
    for index in range(4):
        Image.fromarray(draws.integers(0, 255, (64, 96, 3), np.uint8)).save(source / f"{index}.png")

    def meanwhile():
        (source / "1.png").unlink()
        if change == "saved anew":
            shutil.copyfile(source / "2.png", source / "1.png")

    before(monkeypatch, photos_scene, "check_same", meanwhile)
    with pytest.raises(InputError, match=r"1.png was saved anew or removed while it was read; start again"):
        photographs_scene(source, tmp_path / "scene")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["photos"]


def test_an_image_of_a_transforms_json_that_changes_makes_no_scene(folder, tmp_path, monkeypatch):  # noqa: F811
    copied = shutil.copytree(folder, tmp_path / "nerf")

    def swap():
        shutil.copyfile(copied / "train" / "r_1.png", copied / "train" / "r_0.png")

    before(monkeypatch, transforms, "write_model", swap)
    with pytest.raises(InputError, match=r"r_0.png was saved anew or removed while it was read; start again"):
        transforms_scene(copied / "transforms.json", tmp_path / "scene", TransformsConfig(points=100))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["nerf"]
