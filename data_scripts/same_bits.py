"""Do short runs give the same bits whatever the libraries of this machine choose among?

    python data_scripts/same_bits.py [--only WORD]

Each run is made in a child process of its own, once as the machine is, then with one library at a time held
back to what an older processor has, then with two threads. A line per setting names what differs; the exit
code is 1 if anything does. A setting takes ten seconds of CPU; numba's compiles all kernels once more, two
minutes the first time. tests/test_same_bits.py runs a part of it.
"""

import argparse
import hashlib
import io
import json
import os
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

THREADS = "SAME_BITS_THREADS"  # how many a child takes
_SHORT = (
    "--device cpu --quiet --results . --steps 40 --set size=48 --set views=9 --set dump_steps=20,40 "
    "--set samples=2000 --set budget=200 --set resample_every=15 --set initial_ratio=3 --loss samples=512"
)
_NOISY = (
    "--set background=texture --set image_noise=.02 --set camera_noise=.002 --set cloud_noise=.004 "
    "--set cloud_outliers=.02 --set cloud_missing=.05"
)
RUNS = {  # arguments of `python -m paper_artifact`, in order, in one folder
    "C1": f"train torus --condition C1 {_SHORT}",
    "T2": f"train sphere --condition T2 {_SHORT} {_NOISY} --loss samples=auto --loss noise=.002",
    "C4": f"train double_torus --condition C1 {_SHORT} --loss samples=2048 --loss curvature_weighted=True",
    "B3": f"train cube --condition B3 {_SHORT.replace('--loss samples=512', '')}",
    "scene": "scene --mesh mesh.obj --out photographs --views 9 --size 72 --quiet",
    "photographs": "train --scene photographs --condition T1 --betti 1,0,1 --downscale 1.5 --background mean "
    "--device cpu --quiet --results . --steps 40 --set dump_steps=20,40 --set samples=2000 --set budget=200 "
    "--set resample_every=15 --loss samples=512",
}
SECTIONS = ("losses", "topology", "statement", "bundle", "dumps", "tails", "images", "soup", "mesh")


def settings() -> dict[str, dict[str, str]]:
    """Return the variables of each setting: the libraries' own switches of what they choose by processor."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    numpy_names = " ".join(name for name in __cpu_dispatch__ if __cpu_features__[name])
    return {
        "as the machine is": {},
        "torch without AVX": {"ATEN_CPU_CAPABILITY": "default"},
        "BLAS for Sandy Bridge": {"OPENBLAS_CORETYPE": "Sandybridge"},
        f"numpy without {numpy_names or 'anything'}": {"NPY_DISABLE_CPU_FEATURES": numpy_names},
        "the C library without FMA": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F"},
        "two threads": {THREADS: "2"},
        "numba for Haswell": {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx2,+fma,+bmi,+bmi2"},
    }


def digest(*parts: bytes) -> str:
    """Return twelve hex digits of the sha256 of bytes."""
    return hashlib.sha256(b"".join(parts)).hexdigest()[:12]


def digests(folder: Path) -> dict[str, str]:
    """Return digests of what runs left in a folder: pictures, models, soups, records by section."""
    from PIL import Image

    found: dict[str, str] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".png":
            with Image.open(path) as image:
                found[name] = digest(np.asarray(image).tobytes())
        elif path.suffix == ".bin":
            found[name] = digest(path.read_bytes())
        elif path.suffix == ".npz":
            with np.load(path) as arrays:
                found[name] = digest(*(arrays[each].tobytes() for each in sorted(arrays.files)))
        elif path.parent.name == "runs":
            record = json.loads(path.read_text(encoding="utf-8"))
            for part in SECTIONS:
                if part in record:
                    found[f"{name}: {part}"] = digest(json.dumps(record[part], sort_keys=True).encode())
    return found


def made(only: str) -> dict[str, str]:
    """Return the digests of the runs whose names hold `only`, made in this process."""
    from paper_artifact.cli import main

    threads = ["--threads", os.environ.get(THREADS, "1")]
    with TemporaryDirectory() as temporary:
        os.chdir(temporary)
        _write_ball(Path("mesh.obj"))
        for name, text in RUNS.items():
            if only not in name and not (name == "scene" and only in "photographs"):
                continue
            with redirect_stdout(io.StringIO()):
                if main(text.split() + threads * text.startswith("train")):
                    raise SystemExit(f"{name} failed")
            if name == "scene":
                Path("photographs/scene.json").unlink()  # from here on it is somebody's photographs
        found = digests(Path(temporary))
        os.chdir("/")
    return found


def _write_ball(path: Path) -> None:
    """Write a ball, far from the origin."""
    from paper_artifact.scene.shapes import make_shape

    ball = make_shape("sphere")
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in ball.vertices + [40.0, -7.0, 3.0]]
    lines += [f"f {a} {b} {c}" for a, b, c in ball.faces + 1]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def in_child(variables: dict[str, str], only: str = "") -> dict[str, str]:
    """Return `made` of a child process with these environment variables."""
    command = [sys.executable, __file__, "--child", "--only", only]
    child = subprocess.run(command, env=os.environ | variables, stdout=subprocess.PIPE, check=True)
    return json.loads(child.stdout.splitlines()[-1])


def main() -> int:
    """Run as the docstring says."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help=f"runs whose names hold this, of {', '.join(RUNS)}")
    parser.add_argument("--setting", default="", help="settings whose names hold this, beside the first")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        print(json.dumps(made(given.only)))
        return 0
    first: dict[str, str] | None = None
    different = False
    if not any(given.only in name for name in RUNS):
        parser.error(f"no run's name holds {given.only!r}; choose among {', '.join(RUNS)}")
    tried = settings()
    _, *others = tried
    if not any(given.setting in name for name in others):
        parser.error(f"no setting's name holds {given.setting!r}; choose among {', '.join(others)}")
    for name, variables in tried.items():
        if first is not None and given.setting not in name:
            continue
        found = in_child(variables, given.only)
        if first is None:
            first = found
            print(f"{name}: {digest(json.dumps(found, sort_keys=True).encode())}", flush=True)
            continue
        unequal = sorted(each for each in first.keys() | found.keys() if first.get(each) != found.get(each))
        different |= bool(unequal)
        print(f"{name}: {'same bits' if not unequal else 'differs: ' + ', '.join(unequal)}", flush=True)
    return int(different)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted")
