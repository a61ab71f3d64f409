"""One's own scene folder: what is read of it, and trained, evaluated, exported and swept without a ground
truth."""

import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from unicodedata import normalize

import numpy as np
import pytest
import trimesh
from PIL import Image

from paper_artifact.catalogue import study_config
from paper_artifact.config import GivenConfig
from paper_artifact.errors import InputError
from paper_artifact.files import OWN, RESULTS
from paper_artifact.pipeline import OwnScene, results_of, run
from paper_artifact.record.store import read_record, recorded_path
from paper_artifact.scene.build import SceneConfig, build_scene
from paper_artifact.scene.colmap import read_model, write_model
from paper_artifact.scene.folder import scene_digest, scene_name, scene_root
from paper_artifact.scene.given import resolve
from paper_artifact.scene.load import held_out, load_scene
from paper_artifact.scene.shapes import make_shape
from paper_artifact.study.studies import STUDIES, Block
from paper_artifact.topology.bundle import build_from_mesh
from tests.tiny_run import find_records

CPU = "--quiet --device=cpu"
SMALL = f"{CPU} --steps=24 --set=budget=150 --set=samples=400 --set=resample_every=8 --set=dump_steps=24"


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """A folder as pycolmap leaves it: dense/ with images and a model, no scene.json, no ground truth."""
    folder = tmp_path_factory.mktemp("photos") / "castle" / "dense"
    config = SceneConfig(views=11, size=44, supersample=2, points=400)
    build_scene(make_shape("sphere"), config, folder)
    (folder / "scene.json").unlink()
    (folder / "ground_truth.npz").unlink()
    return folder


@pytest.fixture
def own(photographs, tmp_path):
    """A copy that a test may change."""
    return Path(shutil.copytree(photographs, tmp_path / "castle" / "dense"))


@pytest.fixture
def train(command):
    """train(folder, results, more): return the record of a small run from the command line, and its words."""

    def run(folder, results, more=""):
        before = set((results / "runs").glob("*.json"))
        said = command(f"train --scene {folder} {SMALL} --results={results} {more}")
        (path,) = set((results / "runs").glob("*.json")) - before
        return read_record(path), said

    return run


def test_a_scene_is_trained_recorded_evaluated_and_exported_without_a_ground_truth(
    photographs, tmp_path, train, command
):
    record, said = train(photographs, tmp_path)
    assert "1 void (" in said.out and "held-out PSNR" in said.out and "Chamfer" not in said.out
    assert said.err.count("the SfM cloud has 400 points: it starts from 400") == 1
    assert record["soup"]["resamplings"][0]["before"] == 400
    assert "mesh" not in record and "bottleneck" not in record["tails"] and "frame" not in record
    (dump,) = record["dumps"]
    longest = dump["bars"][2][0]
    assert dump["margins"][2][0] == pytest.approx((longest[1] - longest[0]) / dump["floor"], rel=1e-4)
    assert record["config"]["shape"] == "castle"
    assert record["config"]["given"]["digest"] == scene_digest(photographs)
    assert record["scene"]["views"] == 11 and len(record["scene"]["holdout"]) == 1
    (file,) = (tmp_path / "runs").iterdir()
    for private in (str(photographs), str(photographs.parent.parent), str(Path.home())):
        assert private not in file.read_text()
    soup, out = tmp_path / "soups" / f"{file.stem}.npz", tmp_path / "scores.json"
    line = f"evaluate {soup} --scene {photographs} --samples=400"
    assert "held-out views: PSNR" in command(f"{line} --json={out}").out
    scores = json.loads(out.read_text())
    assert scores["images"]["psnr"] == pytest.approx(record["images"]["psnr"], abs=1e-3)
    assert scores["images"]["of"] == "held-out" and len(scores["margins"]) == 3
    assert "4 rays a pixel" in command(f"{line} --json={out} --supersample=2").out
    finer = json.loads(out.read_text())["images"]
    assert finer["supersample"] == 2 and finer["psnr"] != scores["images"]["psnr"]
    assert "from 1 to 8" in command(f"{line} --supersample=0", code=2).err
    assert "training views: PSNR" in command(f"{line} --holdout=none").out
    assert "give --target" in command(f"evaluate {soup}", code=2).err
    command(f"export {soup} --scene {photographs} --out={tmp_path}/x")
    assert {path.suffix for path in (tmp_path / "x").glob("[!.]*")} == {".ply", ".glb", ".png", ".html"}


def test_a_path_spelled_differently_or_a_moved_folder_is_the_same_run(
    own, tmp_path, monkeypatch, train, command
):
    results = tmp_path / "r"
    first, _ = train(own, results)
    monkeypatch.chdir(own.parent)
    monkeypatch.setattr("paper_artifact.pipeline.train", None)  # calling it would fail
    for spelling in (own, "dense", "./dense/../dense/sparse/0", own / "sparse", own / "images", "."):
        command(f"train --scene {spelling} {SMALL} --results={results}")
    own.parent.rename(tmp_path / "chateau")
    again = command(f"train --scene {tmp_path}/chateau {SMALL} --results={results}")
    assert first["config_hash"] in again.out and len(find_records(results / "runs")) == 1
    # Another picture is another run.
    config = study_config(str(tmp_path / "chateau"), steps=24)
    before = resolve(config).config
    image = tmp_path / "chateau" / "dense" / "images" / "view_004.png"
    Image.new("RGB", (44, 44)).save(image)
    assert resolve(config).config != before
    assert recorded_path(resolve(config).config, results / "runs") is None


def test_a_mesh_file_is_named_by_its_content_too(tmp_path, monkeypatch):
    ball = trimesh.creation.icosphere(subdivisions=2)
    (tmp_path / "a").mkdir()
    ball.export(tmp_path / "a" / "ball.ply")
    monkeypatch.chdir(tmp_path)
    paths = ("a/ball.ply", str(tmp_path / "a" / "ball.ply"))
    first, second = (resolve(study_config(path)).config for path in paths)
    assert first == second and first.shape == "ball.ply" and first.given.digest
    (tmp_path / "spot").mkdir()  # a name of the study stays one
    assert results_of(study_config("spot")) == RESULTS and results_of(study_config("a/ball.ply")) == OWN
    assert results_of(first) == OWN
    trimesh.creation.icosphere(subdivisions=2, radius=2).export(tmp_path / "a" / "ball.ply")
    assert resolve(study_config("a/ball.ply")).config != first
    with pytest.raises(InputError, match="does not know where ball.ply lies"):
        resolve(first)


def test_the_run_resumes_from_its_checkpoint_to_the_same_bits(photographs, tmp_path):
    short = {"steps": 24, "budget": 150, "samples": 400, "resample_every": 8, "dump_steps": (24,)}
    config = study_config(str(photographs), **short)
    whole = run(config, results=tmp_path / "a", device="cpu")

    def stop(step, text):
        if step == 18:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(config, results=tmp_path / "b", device="cpu", progress=stop)
    resumed = run(config, results=tmp_path / "b", device="cpu")
    assert resumed["resumed_at"] == 16 and resumed["losses"] == whole["losses"]
    assert resumed["dumps"] == whole["dumps"] and resumed["images"] == whole["images"]


def test_words_and_targets(photographs, tmp_path, train, command):
    sphere = make_shape("sphere")
    bundle, ball, far = (tmp_path / name for name in ("bundle.json", "ball.ply", "far.ply"))
    build_from_mesh(sphere.vertices, sphere.faces, 512, dimensions=(2,)).save(bundle)
    trimesh.Trimesh(sphere.vertices, sphere.faces).export(ball)
    trimesh.Trimesh(1000 * sphere.vertices, sphere.faces).export(far)
    record, _ = train(photographs, tmp_path, "--condition=T1 --betti=1,0,1 --loss=samples=512")
    assert record["statement"]["betti"] == [1, 0, 1] and "mesh" not in record
    record, _ = train(photographs, tmp_path, f"--condition=C1 --target={bundle}")
    assert record["bundle"]["samples"] == 512 and record["config"]["loss"]["samples"] == 512
    assert record["config"]["loss"]["dimensions"] == [2] and "mesh" not in record
    line = f"train --scene {photographs} {CPU} --condition=C1"
    assert "samples is 512 in" in command(f"{line} --target={bundle} --loss=samples=64", code=1).err
    assert [event["event"] for event in record["topology"]].count("lambda") == 1
    record, _ = train(photographs, tmp_path, f"--condition=C2 --target={ball} --loss=samples=512")
    assert record["mesh"]["name"] == "ball" and record["tails"]["chamfer"] > 0
    assert str(ball) not in json.dumps(record)
    assert "which photographs do not bring: give --target" in command(line, code=1).err
    given = resolve(study_config(str(photographs)))
    big = build_from_mesh(9 * sphere.vertices, sphere.faces, 512, dimensions=(2,))
    (_, scale) = OwnScene(replace(given, bundle=big)).remarks(load_scene(given.folder))
    assert "the target's diagonal is 9" in scale or "times the SfM cloud's" in scale
    short = f"{CPU} --steps=2 --set=dump_steps=2, --condition=C1 --loss=samples=512 --target={far}"
    said = command(f"train --scene {photographs} {short} --results={tmp_path}/far").err
    assert "bring both to one unit of length" in said


def test_a_photograph_that_shows_nothing_is_named(own, capsys):
    name = load_scene(own).names[3]
    Image.new("RGB", (44, 44), "white").save(own / "images" / name)
    load_scene(own)
    assert f"1 of 11 photographs are of a single colour and show nothing: {name}" in capsys.readouterr().err


def test_the_sweep_takes_a_scene_and_a_study_may_name_one(photographs, tmp_path, monkeypatch, command):
    line = f"sweep --scene {photographs} {SMALL.replace('--device=cpu', '')} --results={tmp_path} --seed=1"
    both = f"{line} --condition=C0 --condition=T1 --betti=1,0,1 --seed=0"
    assert "missing: castle T1 seed 1" in command(f"{both} --list").out
    assert "1 runs done" in command(line).out
    assert "1 of 1 runs recorded" in command(f"{line} --list").out
    block = Block((str(photographs),), ("C0",), range(1, 2))
    monkeypatch.setitem(STUDIES, "mine", (block,))
    listed = command(f"sweep mine --list --results={tmp_path}").out
    assert "0 of 1 runs recorded" in listed  # of 2,500 steps, not of 24
    command("sweep", code=2)


def test_the_sweep_takes_a_mesh(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    trimesh.creation.icosphere(1).export("my ball.ply")
    line = "sweep 'my ball.ply' --quiet --results=r --condition=C0 --condition=T3 --betti=1,0,1 --steps=2 "
    line += "--set=size=32 --set=views=8 --set=budget=30 --set=samples=64 --seed=0"
    told, following = command(f"{line} --seed=0").out.splitlines()
    assert "2 runs done, 0 were recorded before" in told
    export, soup, *target = shlex.split(following)[4:]
    assert export == "export" and Path(soup).is_file() and target == ["--target", "my ball.ply"]
    told = command(f"{line} --seed=1 --list").out
    assert "missing: my ball.ply T3 seed 1\n2 of 4" in told
    again = command("", *shlex.split(told.splitlines()[-1])[4:])  # the command that it proposes
    assert "2 runs done, 2 were recorded before" in again.out


@pytest.mark.parametrize(
    "option, words",
    [
        ("--downscale=0.5", "downscale must be at least 1"),
        ("--downscale=4", "at least 22 a side are needed"),
        ("--background=pink", "unknown background 'pink'"),
        ("--holdout=a.jpg", "no view is called a.jpg"),
        ("--holdout=1", "leaves no view to train on"),
        ("--holdout=", "no view is called ''"),
        ("--set=views=3", "views would change scenes that are rendered from a mesh"),
        ("--target=none.obj", "no mesh file at none.obj"),
        ("--target=none.json", "cannot read the bundle none.json"),
        ("sphere", "give either a shape"),
    ],
)
def test_bad_options_are_one_sentence(photographs, option, words, tmp_path, command):
    code = 2 if words.startswith(("downscale", "give either")) else 1
    error = command(f"train --scene {photographs} {CPU} --results={tmp_path} {option}", code=code).err
    assert words in error and len(error.splitlines()) == 1


def test_options_of_a_scene_belong_to_a_scene(command):
    for option in ("--downscale=2", "--holdout=4", "--target=a.obj"):
        assert "--scene DIR" in command(f"train sphere {CPU} {option}", code=2).err
    assert "give either" in command(f"train {CPU}", code=2).err


def test_photographs_are_read_smaller_over_a_background_and_through_masks(own):
    plain = load_scene(own)
    small = load_scene(own, downscale=2)
    assert small.images.shape == (11, 3, 22, 22) and small.images.dtype == np.uint8
    mean = plain.images.reshape(11, 3, 22, 2, 22, 2).mean(axis=(3, 5))
    assert np.abs(small.images - mean).max() <= 1
    np.testing.assert_array_equal(small.world_to_clip, plain.world_to_clip)
    average = load_scene(own, background="mean").background
    np.testing.assert_allclose(average, plain.colours(plain.train).mean(axis=(0, 1, 2)), atol=1e-6)
    (own / "masks").mkdir()
    mask = np.zeros((44, 44), np.uint8)
    mask[:, :22] = 255
    for place, name in enumerate(plain.names):
        Image.fromarray(mask).save(own / "masks" / (name if place % 2 else f"{name}.png"))
    masked = load_scene(own, background="#0080ff")
    np.testing.assert_array_equal(masked.images[..., :22], plain.images[..., :22])
    assert (masked.images[..., 22:] == np.array([0, 128, 255])[:, None, None]).all()
    half = load_scene(own, background="mean").background
    np.testing.assert_allclose(half, plain.colours(plain.train)[:, :, :22].mean(axis=(0, 1, 2)), atol=1e-6)
    digest = scene_digest(own)
    (own / "masks").rename(own / "unused")
    assert scene_digest(own) != digest
    (own / "unused").rename(own / "masks")
    (own / "masks" / plain.names[3]).unlink()
    with pytest.raises(InputError, match="has no mask for view_003.png"):
        load_scene(own)
    for name in plain.names:  # transparent where the other masks were black
        clear = Image.new("RGBA", (44, 44), "white")
        clear.putalpha(Image.fromarray(mask))
        clear.save(own / "masks" / name)
    np.testing.assert_array_equal(load_scene(own, background="#0080ff").images, masked.images)
    Image.fromarray(mask // 255).save(own / "masks" / plain.names[3])
    with pytest.raises(InputError, match="has values up to 1; save what counts as white, 255"):
        load_scene(own)
    Image.new("RGB", (44, 44), "lime").save(own / "masks" / plain.names[3])
    with pytest.raises(InputError, match="is coloured; save white where"):
        load_scene(own)
    Image.new("L", (9, 9)).save(own / "masks" / plain.names[3])
    with pytest.raises(InputError, match="9×9 pixels, its photograph 44×44"):
        load_scene(own)


def test_settings_of_no_scene_are_refused(photographs):
    for wrong in ({"downscale": 0}, {"downscale": np.nan}, {"background": (1, 1, 1)}, {"holdout": ["a"]}):
        with pytest.raises(InputError):
            load_scene(photographs, **wrong)
    with pytest.raises(InputError, match="downscale must be at least 1"):
        GivenConfig(downscale=float("nan"))
    with pytest.raises(InputError, match="named by its folder's path"):
        load_scene(None)
    assert len(load_scene(photographs, holdout=2).holdout) > 1


def test_which_views_are_held_out(photographs):
    names = [f"{index:02d}.jpg" for index in range(11)]
    # A walk: eleven steps, the first far from all others.
    walk = np.column_stack([np.arange(11.0), np.zeros(11), np.zeros(11)])
    walk[0] = [-50, 0, 0]
    assert held_out("auto", names, walk).tolist() == [5]
    assert held_out("auto", names + names[:5], np.vstack([walk, walk[6:] + 5])).size == 2
    assert held_out("auto", names[:2], walk[:2]).tolist() == [1]
    assert held_out("none", names, walk).tolist() == []
    assert held_out("4", names, walk).tolist() == [0, 4, 8]
    assert held_out("9" * 5000, names, walk).tolist() == [0]
    assert held_out("07.jpg, 02.jpg", names, walk).tolist() == [2, 7]
    scene = load_scene(photographs, holdout="none")
    assert len(scene.train) == 11


def test_the_folder_is_found_by_what_people_give(own, tmp_path):
    for given in (own, own / "sparse", own / "sparse" / "0", own / "images", own.parent):
        assert scene_root(given) == own and scene_name(scene_root(given)) == "castle"
    with pytest.raises(InputError, match="no scene folder at"):
        scene_root(tmp_path / "none")
    with pytest.raises(InputError, match="no COLMAP file at"):
        load_scene(tmp_path)
    expected, digest = load_scene(own), scene_digest(own)
    for model, images in (("sparse/1", "input"), ("colmap/sparse/0", "images_4"), ("beside", "images")):
        root = Path(shutil.copytree(own, tmp_path / model / "scene"))
        (root / "images").rename(root / images)
        shutil.move(root / "sparse" / "0", root / "moved")
        (root / "sparse").rmdir()
        if model == "beside":
            for file in (root / "moved").iterdir():
                file.rename(root / file.name)
        else:
            (root / model).parent.mkdir(parents=True, exist_ok=True)
            (root / "moved").rename(root / model)
        assert np.array_equal(load_scene(root).images, expected.images) and scene_digest(root) == digest
    for name in ("sparse/mug", "images", "input"):  # what a scene is called, or lies in, says nothing
        root = Path(shutil.copytree(own, tmp_path / "called" / name))
        assert scene_root(root) == root
    shutil.copytree(own / "images", own.parent / "images")  # the photographs as taken, beside dense/
    assert scene_root(own.parent / "images") == own


def test_names_that_nearly_match_and_views_without_image(own, capsys):
    expected = load_scene(own)
    for index, file in enumerate(sorted((own / "images").iterdir())):
        file.rename(file.with_suffix(".PNG" if index % 2 else ".tif"))
    assert np.array_equal(load_scene(own).images, expected.images)
    next((own / "images").glob("*.tif")).unlink()
    scene = load_scene(own)
    assert len(scene.names) == 10 and "1 of 11 views are left out" in capsys.readouterr().err
    for file in sorted((own / "images").iterdir())[1:]:
        file.unlink()
    with pytest.raises(InputError, match=r"no image at .* \(10 of 11 are missing\)"):
        load_scene(own)


def test_a_tiff_file_with_an_orientation_and_another_programs_description_are_refused(own):
    file = min((own / "images").iterdir())
    with Image.open(file) as picture:
        picture.save(file.with_suffix(".tif"), tiffinfo={274: 3})
    file.unlink()
    with pytest.raises(InputError, match=r"\.tif has an orientation tag"):
        load_scene(own)
    (own / "scene.json").write_text('{"scale": 0.1, "center": [0, 0, 0], "near": 0.1, "far": 2}')
    with pytest.raises(InputError, match=r"another program's .*; move it away"):
        load_scene(own)


def test_no_other_model_and_no_other_photograph_is_read(own, capsys):
    """Than what was asked for, and than those of the first folder that holds photographs."""
    shutil.copytree(own / "sparse" / "0", own / "sparse" / "1")
    assert scene_root(own / "sparse" / "0") == own and len(load_scene(own).names) == 11
    assert "1 of 2 models are not read, 0 is: 1" in capsys.readouterr().err
    with pytest.raises(
        InputError, match=r"sparse/1 is not the folder that is read, .*sparse/0; move the others"
    ):
        scene_root(own / "sparse" / "1")
    first, second = sorted((own / "images").iterdir())[:2]
    (own / "input").mkdir()
    first.rename(own / "input" / first.name)
    assert first.name not in load_scene(own).names and "1 of 11 views" in capsys.readouterr().err
    (own / "input" / first.name).rename(first)
    model = read_model(own / "sparse" / "0")
    model.images[1] = replace(model.images[1], name=Path(model.images[2].name).with_suffix(".jpg").name)
    write_model(model, own / "sparse" / "0")
    assert len(load_scene(own).names) == 10, "view 2's .png is not view 1's"
    for image in (1, 2):
        model.images[image] = replace(model.images[image], name=f"/rig/{image}/{second.name}")
    write_model(model, own / "sparse" / "0")
    with pytest.raises(InputError, match="would be the photograph of two images, /rig/1/.* and /rig/2/"):
        load_scene(own)
    (own / "images_2").mkdir()
    with pytest.raises(InputError, match=r"images_2 is not the folder that is read"):
        scene_root(own / "images_2")


def test_accents_and_commas_in_names(own):
    accented = "Bär, müde.png"
    model = read_model(own / "sparse" / "0")
    file = own / "images" / model.images[1].name
    file.rename(file.with_name(normalize("NFD", accented)))
    model.images[1] = replace(model.images[1], name=accented)
    write_model(model, own / "sparse" / "0")
    scene = load_scene(own, holdout=accented)
    assert len(scene.names) == 11 and [scene.names[view] for view in scene.holdout] == [accented]
