"""Short runs and products whose bits are kept: `python -m tests.short_runs [--only PATTERN] [--write]`.

All of it takes a minute of CPU. A change that is meant to keep results keeps the digests of
short_runs.json; one that changes words alone shows in `topology` (notes), `audit` and `solidify`. --write
replaces the digests of what was run. Exit code 1 where one differs.
"""

import argparse
import hashlib
import io
import json
import os
import platform
import re
import sys
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

KEPT = Path(__file__).with_suffix(".json")
ROOT = KEPT.parents[1]

# Name → arguments of `python -m paper_artifact`, in order, in one folder; {mesh}: a torus made here, {bob}: a
# committed soup. Later ones use what earlier ones made, which --only has to match too.
BOB = ROOT / "results" / "soups" / "bob-C1-s0-3d08ae5771c7.npz"
SHORT = "--device cpu --quiet --results . --steps 120 --set size=64 --set views=12 --set dump_steps=40,80,120"
TERM = "--set budget=300 --set resample_every=30 --loss samples=512"
LOSS = f"{SHORT} {TERM}"
GIVEN = "--device cpu --quiet --results . --steps 120 --set dump_steps=40,80,120"
RUNS = {
    "sphere C0": f"train sphere {SHORT}",
    "sphere C0, noise": f"train sphere {SHORT} --set image_noise=.02 --set camera_noise=.002 "
    "--set cloud_noise=.004 --set cloud_outliers=.02 --set cloud_missing=.05 --set background=texture",
    "sphere C1": f"train sphere --condition C1 {LOSS}",
    "sphere C2": f"train sphere --condition C2 {LOSS}",
    "sphere C5": f"train sphere --condition C5 {LOSS}",
    "sphere C6": f"train sphere --condition C6 --seed 1 {LOSS}",
    "sphere C7": f"train sphere --condition C7 {LOSS}",
    "sphere T2": f"train sphere --condition T2 {LOSS}",
    "torus C1": f"train torus --condition C1 {LOSS} --set size=96",
    "torus T1": f"train torus --condition T1 {LOSS} --set size=96 --loss samples=auto",
    "cube B1": f"train cube --condition B1 {SHORT}",
    "own mesh C1": f"train {{mesh}} --condition C1 {LOSS} --loss samples=2048",
    "scene": "scene --mesh {mesh} --out scene --views 12 --size 64 --quiet",
    "own scene T1": f"train --scene scene --condition T1 --betti 1,2,1 {GIVEN} --loss samples=512",
    "own scene C1": f"train --scene scene --target {{mesh}} --condition C1 {GIVEN} {TERM} "
    "--loss samples=2048",
    "own scene C0": f"train --scene scene --downscale 2 --background black --holdout 3 {GIVEN}",
    "evaluate": "evaluate torus.npz --target {mesh} --scene scene --samples 3000 --json e.json --quiet",
    "certify": "certify {mesh} --json certify.json --quiet",
    "audit": "audit {mesh} --out audit --densities 1024 2048 --working 1024 2048 --quiet",
    "solidify": "solidify {bob} --out solid.ply --betti 1,2,1 --offsets .012,.016 --json s.json --quiet",
    "export": "export torus.npz --out exported --formats ply glb png --views 2 --size 64 --quiet",
    "ingest": "ingest {mesh} --out shell.ply --offset .03 --quiet",
}
SECTIONS = (
    "dumps", "losses", "topology", "statement", "bundle", "images", "tails", "soup", "mesh", "scene", "frame",
)  # fmt: skip
SECONDS = re.compile(
    r"second|memory|time|version|path|cpu|host|package|^mesh$|^name$|^commands$|sentence|remark|word"
)


def torus_obj() -> str:
    """Return a torus of 24 × 12 quads as the text of an OBJ file."""
    lines, (around, across) = [], (24, 12)
    for u in np.arange(around) * 2 * np.pi / around:
        for v in np.arange(across) * 2 * np.pi / across:
            wide = 1 + 0.4 * np.cos(v)
            lines.append(f"v {wide * np.cos(u):.6f} {wide * np.sin(u):.6f} {0.4 * np.sin(v):.6f}")
    for i in range(around):
        for j in range(across):
            a, b = i * across, (i + 1) % around * across
            k = (j + 1) % across
            lines += [f"f {a + j + 1} {b + j + 1} {b + k + 1}", f"f {a + j + 1} {b + k + 1} {a + k + 1}"]
    return "\n".join(lines) + "\n"


def short(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def bare(value: object) -> object:
    """Return a JSON value without times, versions, paths and sentences."""
    if isinstance(value, dict):
        return {name: bare(each) for name, each in sorted(value.items()) if not SECONDS.search(name)}
    return [bare(each) for each in value] if isinstance(value, list) else value


def digests(folder: Path, since: dict[Path, float]) -> dict[str, str]:
    """Return digests of what a command wrote into the folder; a run's by section."""
    found: dict[str, str] = {}
    for path in sorted(folder.rglob("*")):
        if not path.is_file() or since.get(path) == path.stat().st_mtime or path.suffix in (".html", ".obj"):
            continue
        name, place = str(path.relative_to(folder)), path.parent.name
        if place == "checkpoints" or "scenes" in path.parts or path.name.startswith("."):
            continue
        if place == "runs":
            record = json.loads(path.read_text(encoding="utf-8"))
            for part in SECTIONS:
                if part in record:
                    found[f"{name}: {part}"] = short(json.dumps(record[part], sort_keys=True).encode())
        elif place == "soups":
            with np.load(path) as arrays:
                found[name] = short(b"".join(arrays[each].tobytes() for each in sorted(arrays.files)))
        elif path.suffix == ".json":
            found[name] = short(json.dumps(bare(json.loads(path.read_text(encoding="utf-8")))).encode())
        else:
            found[name] = short(path.read_bytes())
    return found


def retrain(only: str) -> dict[str, dict[str, str]]:
    """Return the digests of each short run and product, made now, in this process."""
    from paper_artifact.cli import main

    found = {}
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "torus.obj").write_text(torus_obj(), encoding="utf-8")
        before = os.getcwd()
        os.chdir(folder)
        try:
            for name, text in RUNS.items():
                if only and not re.search(only, name):
                    continue
                since = {path: path.stat().st_mtime for path in folder.rglob("*") if path.is_file()}
                words = [word.format(mesh=folder / "torus.obj", bob=BOB) for word in text.split()]
                with redirect_stdout(io.StringIO()):
                    code = main(words)
                if code:
                    found[name] = {"exit code": str(code)}
                    continue
                found[name] = digests(folder, since)
                if name == "own mesh C1":
                    newest = max((folder / "soups").glob("*.npz"), key=lambda path: path.stat().st_mtime)
                    Path("torus.npz").write_bytes(newest.read_bytes())
        finally:
            os.chdir(before)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--only", default="", help="names that match this pattern")
    parser.add_argument("--write", action="store_true", help="keep the digests of now")
    given = parser.parse_args()
    if platform.machine() != "x86_64":
        print(f"the digests hold on x86-64 with FMA; this is {platform.machine()}, whose bits may differ")
        return 1
    kept = json.loads(KEPT.read_text(encoding="utf-8"))
    made = retrain(given.only)
    bad = 0
    for name, parts in made.items():
        wanted = kept.get(name, {})
        differs = [part for part in {**wanted, **parts} if parts.get(part) != wanted.get(part)]
        bad += bool(differs)
        print(f"{name}: {', '.join(differs) or 'same bits'}")
    if given.write:
        KEPT.write_text(json.dumps(kept | made, indent=1) + "\n", encoding="utf-8")
    return int(bad > 0 and not given.write)


if __name__ == "__main__":
    sys.exit(main())
