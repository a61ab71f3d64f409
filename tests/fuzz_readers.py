"""Every reader on mutated files: `python -m tests.fuzz_readers 2000`.

A mutated file may be read, or refused by an InputError of one line that names it. Anything else is a fault:
another exception, a crash, more than SECONDS of CPU for one file, more than 2 GiB beyond what the process had
before. Files are read in a child process, which a fault may end. File number i of a seed is always the same.
"""

import argparse
import json
import resource
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import trimesh
from PIL import ExifTags, Image

from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.randomness import stream
from tests.colmap_text import write_text_model
from tests.fuzz_mutations import (
    Mutation,
    mutate_bytes,
    mutate_glb,
    mutate_json,
    mutate_png,
    mutate_sealed,
    mutate_words,
    mutate_zip,
)

SECONDS = 10  # of CPU, for one file that is read in milliseconds
MEMORY = 2 << 30  # bytes


@dataclass(frozen=True)
class Sample:
    """A sound file and its reader."""

    file: Path  # the one to mutate
    read: Callable[[], object]
    mutations: tuple[Mutation, ...]


def samples(folder: Path) -> dict[str, Sample]:
    """Write the sound files below `folder` and return them by kind."""
    return _scenes(folder) | _pictures(folder) | _meshes(folder) | _texts(folder) | _soups(folder)


def _scenes(folder: Path) -> dict[str, Sample]:
    from paper_artifact.files import write_json
    from paper_artifact.scene.colmap import Intrinsics, Model, Pose, read_model, write_model
    from paper_artifact.scene.load import load_scene

    draws = stream(0, "fuzz scene")
    names = ["a.png", "b.jpg", "c.tif", "d.png"]
    cameras = {1: Intrinsics("PINHOLE", 24, 16, (20.0, 21.0, 12.0, 8.0))}
    poses = (Pose(name, 1, (1.0, 0.0, 0.1 * i, 0.0), (0.0, 0.1, 3.0)) for i, name in enumerate(names))
    points, colours = draws.normal(size=(8, 3)), draws.integers(0, 256, (8, 3)).astype(np.uint8)
    model = Model(cameras, dict(enumerate(poses, 1)), np.arange(1, 9), points, colours, np.ones(8))
    found = {}
    for kind, words in (("bin", False), ("txt", True)):
        place = folder / kind
        (write_text_model if words else write_model)(model, place)
        for name in ("cameras", "images", "points3D"):
            mutations = (mutate_bytes, mutate_words) if words else (mutate_bytes,)
            file = place / f"{name}.{kind}"
            found[f"COLMAP {file.name}"] = Sample(file, partial(read_model, place), mutations)
    scene = folder / "scene"
    write_model(model, scene / "sparse" / "0")
    (scene / "images").mkdir()
    for name in names:
        pixels = draws.integers(0, 256, (16, 24, 4 if name[0] == "a" else 3)).astype(np.uint8)
        Image.fromarray(pixels).save(scene / "images" / name)
        found[f"image {name}"] = Sample(scene / "images" / name, partial(load_scene, scene), of_picture(name))
    write_json(scene / "scene.json", {"background": [1.0, 0.5, 0.0], "radius": 1.0, "key": "x"})
    texts = (mutate_bytes, mutate_json)
    found["scene.json"] = Sample(scene / "scene.json", partial(load_scene, scene), texts)
    return found


def of_picture(name: str) -> tuple[Mutation, ...]:
    """Return the mutations of a picture file."""
    return (mutate_bytes, mutate_png) if name.endswith(".png") else (mutate_bytes,)


def _pictures(folder: Path) -> dict[str, Sample]:
    """Return photographs as `photos` reads them, before structure from motion, and NeRF's RGBA views."""
    from paper_artifact.files import write_json
    from paper_artifact.photos.pictures import photographs_in, prepared
    from paper_artifact.scene import subject
    from paper_artifact.scene.load import load_scene
    from paper_artifact.scene.transforms import TransformsConfig, transforms_scene

    draws = stream(0, "fuzz pictures")
    exif = Image.Exif()
    exif[ExifTags.Base.Model], exif[ExifTags.Base.Orientation] = "a camera", 6
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength] = 4.2
    photographs, nerf = folder / "photographs", folder / "nerf"
    photographs.mkdir(), nerf.mkdir()

    def photos() -> None:
        with tempfile.TemporaryDirectory() as work:
            prepared(photographs_in(photographs), Path(work) / "pictures", Path(work) / "masks", 64, False)

    found = {}
    for name in ("a.jpg", "b.png", "c.tif", "d.webp", "e.bmp"):
        pixels = draws.integers(0, 256, (16, 24, 3)).astype(np.uint8)
        Image.fromarray(pixels).save(photographs / name, exif=exif)
        found[f"photograph {name}"] = Sample(photographs / name, photos, of_picture(name))

    ball = np.hypot(*np.indices((24, 24)) - 11.5) < 8
    frames, matrices = [], trimesh.transformations
    for index, angle in enumerate(np.linspace(0, 2 * np.pi, 5)[:-1]):
        pixels = np.dstack([draws.integers(0, 256, (24, 24, 3)), 255 * ball]).astype(np.uint8)
        Image.fromarray(pixels).save(nerf / f"r_{index}.png")
        pose = matrices.rotation_matrix(angle, (0, 1, 0)) @ matrices.translation_matrix((0, 0, 4))
        frames.append({"file_path": f"./r_{index}", "transform_matrix": pose.tolist()})
    size = {"fl_x": 30.0, "fl_y": 31.0, "cx": 12.0, "cy": 12.5, "w": 24, "h": 24}
    write_json(nerf / "transforms.json", {"camera_angle_x": 0.8, **size, "frames": frames})

    def transforms() -> object:
        # Coarser than the command's hull, which is not what is mutated, and takes three seconds.
        with tempfile.TemporaryDirectory() as work, patch.multiple(subject, COARSE=8, FINE=16):
            config = TransformsConfig(size=24, points=50)
            return load_scene(transforms_scene(nerf / "transforms.json", Path(work) / "scene", config))

    texts = (mutate_bytes, mutate_json, mutate_json)
    found["transforms.json"] = Sample(nerf / "transforms.json", transforms, texts)
    found["RGBA view"] = Sample(nerf / "r_1.png", transforms, (mutate_bytes, mutate_png))
    return found


def _meshes(folder: Path) -> dict[str, Sample]:
    from paper_artifact.mesh import load_mesh

    found = {}
    own = {"ascii.ply": mutate_words, "obj.obj": mutate_words, "off.off": mutate_words, "glb.glb": mutate_glb}
    for name in ("ply.ply", "ascii.ply", "obj.obj", "off.off", "stl.stl", "glb.glb"):
        file = folder / name
        trimesh.creation.icosphere(1).export(file, **{"encoding": "ascii"} if name == "ascii.ply" else {})
        mutations = (mutate_bytes, own[name]) if name in own else (mutate_bytes,)
        found[f"mesh {name}"] = Sample(file, partial(load_mesh, file), mutations)
    return found


def _texts(folder: Path) -> dict[str, Sample]:
    from paper_artifact.record.store import read_record, write_record
    from paper_artifact.topology.bundle import load_bundle
    from tests.tiny_run import bare_record, tiny_config
    from tests.topology_cases import handmade_bundle

    log = [
        {"event": "refresh", "step": step, "pairs": 3, "bars": [[0.1 * step, 0.5]]} for step in range(1, 30)
    ]
    dumps = [{"step": step, "counts": [0, 0, 1], "bottleneck": [0.1, 0.2, 0.3]} for step in (20, 30, 60)]
    config = tiny_config(condition="C1")
    truth = {"name": "ball", "dimension": 2}
    record = write_record(bare_record(config, dumps, topology=log, mesh=truth), folder / "runs")
    handmade_bundle([[0.1, 0.4], [0.1, 0.3]], 1, 512).save(folder / "bundle.json")
    texts = (mutate_bytes, mutate_json, mutate_json)
    return {
        "record": Sample(record, partial(read_record, record), texts),
        "bundle": Sample(folder / "bundle.json", partial(load_bundle, folder / "bundle.json"), texts),
    }


def _soups(folder: Path) -> dict[str, Sample]:
    from types import SimpleNamespace

    import torch

    from paper_artifact.soup.adam import SoupOptimiser
    from paper_artifact.soup.initialise import initial_soup
    from paper_artifact.soup.state import load_soup, save_soup
    from paper_artifact.train.state import TrainState, resumed_state, write_checkpoint
    from tests.tiny_run import tiny_config

    torch.set_num_threads(1)
    file, checkpoint = folder / "soup.npz", folder / "checkpoint.pt"
    soup = initial_soup(stream(0, "fuzz soup").normal(size=(40, 3)).astype(np.float32), 12, 0)
    save_soup(file, soup)
    backend: Any = SimpleNamespace(to_host=lambda each: each, to_device=lambda each: each)
    state = TrainState(10, soup, SoupOptimiser(soup), losses=[0.5] * 10)
    write_checkpoint(checkpoint, tiny_config(), state, None, backend)
    resume = partial(resumed_state, checkpoint, tiny_config(), None, backend)
    return {
        "soup": Sample(file, partial(load_soup, file), (mutate_bytes, mutate_zip)),
        "checkpoint": Sample(checkpoint, resume, (mutate_bytes, mutate_sealed)),
    }


def outcome(sample: Sample) -> str:
    """Return "read", "refused", or what is wrong."""
    try:
        sample.read()
    except InputError as error:
        causes = [error.__cause__, getattr(error.__cause__, "__cause__", None)]
        if any(isinstance(cause, MemoryError) for cause in causes):
            return "more than 2 GiB"
        text, file = str(error), sample.file
        named = any(name in text for name in (file.name, str(file.parent), file.parent.parent.name))
        return "refused" if named and "\n" not in text else f"not one line that names a file: {text!r}"
    except MemoryError:
        return "more than 2 GiB"
    except Exception as error:
        frame = error.__traceback__
        while frame is not None and frame.tb_next is not None:
            frame = frame.tb_next
        where = f"{Path(frame.tb_frame.f_code.co_filename).name}:{frame.tb_lineno}" if frame else "?"
        return f"{type(error).__name__} at {where}: {' '.join(str(error).split())[:100]}"
    return "read"


def child(first: int, last: int, seed: int) -> None:
    """Read the files `first` to `last` - 1 of the seed.

    Prints a line of JSON before each, with number, kind and null, and one behind it, with the outcome.
    """
    with tempfile.TemporaryDirectory() as folder:
        known = samples(Path(folder))
        for kind, sample in known.items():
            assert outcome(sample) == "read", f"the sound {kind}: {outcome(sample)}"
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
        signal.signal(signal.SIGPROF, signal.SIG_DFL)  # ends the process, whatever code it is in
        for index in range(first, last):
            kind = list(known)[index % len(known)]
            sample, draws = known[kind], stream(seed, "fuzz", index)
            sound = sample.file.read_bytes()
            mutation = sample.mutations[draws.integers(len(sample.mutations))]
            sample.file.write_bytes(mutation(sound, draws))
            print(json.dumps([index, f"{kind}, {mutation.__name__}", None]), flush=True)
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            result = outcome(sample)
            signal.setitimer(signal.ITIMER_PROF, 0)
            print(json.dumps([index, f"{kind}, {mutation.__name__}", result]), flush=True)
            sample.file.write_bytes(sound)


def fuzz(count: int, seed: int = 0) -> dict[int, tuple[str, str]]:
    """Return {file number: (kind and mutation, outcome)} of `count` mutated files."""
    found: dict[int, tuple[str, str]] = {}
    while len(found) < count:
        command = [sys.executable, "-W", "ignore", "-m", "tests.fuzz_readers", "--child", f"{len(found)}"]
        command += [str(count), "--seed", str(seed)]
        ended = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True)
        rows = [json.loads(line) for line in ended.stdout.splitlines()]
        found |= {index: (kind, result) for index, kind, result in rows if result is not None}
        if ended.returncode == 0:
            break
        if not rows or rows[-1][2] is not None:
            raise RuntimeError(f"the child process failed: {ended.stderr[-2000:]}")
        index, kind, _ = rows[-1]
        hang = ended.returncode == -signal.SIGPROF
        fault = f"more than {SECONDS} s" if hang else f"the process ended with {ended.returncode}"
        found[index] = kind, fault
    return found


def main() -> int:
    """Print a table by kind, and every fault; return 1 when there is one."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=2000, help="mutated files (2000)")
    parser.add_argument("--seed", type=int, default=0, help="another one gives other files (0)")
    parser.add_argument("--child", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child is not None:
        child(arguments.child, arguments.count, arguments.seed)
        return 0
    found = fuzz(arguments.count, arguments.seed)
    faults = {index: each for index, each in found.items() if each[1] not in ("read", "refused")}
    outcomes = {index: "fault" if index in faults else found[index][1] for index in found}
    table = Counter((kind.partition(",")[0], outcomes[index]) for index, (kind, _) in found.items())
    for kind in sorted({kind for kind, _ in table}):
        print(f"{kind:24s}", *(f"{table[kind, what]:6d} {what}" for what in ("read", "refused", "fault")))
    for index, (kind, result) in faults.items():
        print(f"file {index} ({kind}): {result}")
    print(f"{len(found)} mutated files, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
