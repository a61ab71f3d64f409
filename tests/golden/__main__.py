"""Holds the tree against commit 76446f5: `python -m tests.golden [cells|pairs|records|help|runs|all]`.

Scaffolding for the time in which the notebooks, the command line and the rooms of the package are rewritten;
it is deleted afterwards. Layout and wording may change. What is compared: numbers of the notebooks, claims,
committed records, options of the verbs, the bits of short runs. `intended.csv` lists the differences that are
meant, with the reason; they are counted apart. Exit code 1 when anything else differs.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import hashlib
import io
import json
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import redirect_stdout
from html import unescape
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
NUMBER = re.compile(r"(?<![\w.])[-−+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+−]?\d+)?")
Number = tuple[float, int, bool]  # value, decimals printed, a percentage


def texts_of(notebook: Path) -> Iterator[str]:
    """Yield what a notebook's outputs show: cells and heads of tables, printed lines."""
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "text/html" in data:
                for text in re.findall(r"<t[hd].*?>(.*?)</t[hd]>", "".join(data["text/html"]), re.DOTALL):
                    yield unescape(re.sub("<[^>]*>", "", text))
            else:
                yield from "".join(output.get("text", data.get("text/plain", ""))).splitlines()


def numbers(text: str) -> list[tuple[str, Number]]:
    """Return the numbers of a text as (printed, parsed)."""
    found = []
    for match in NUMBER.finditer(text.replace("−", "-")):
        mantissa = re.split("[eE]", match[0])
        decimals = len(mantissa[0].partition(".")[2]) - (int(mantissa[1]) if len(mantissa) > 1 else 0)
        percent = text[match.end() : match.end() + 2].strip().startswith("%")
        found.append((match[0], (float(match[0]), decimals, percent)))
    return found


def same(wanted: Number, shown: np.ndarray) -> bool:
    """Whether a number is among those shown (n,2: value, decimals), to the digits printed by the coarser."""
    value, decimals, percent = wanted
    unit = 10.0 ** -np.minimum(decimals, shown[:, 1])
    near = np.abs(shown[:, 0] - value) <= 0.5 * unit + 1e-12 * abs(value)
    near &= (shown[:, 1] >= decimals) | (
        np.abs(shown[:, 0]) >= 10 * unit
    )  # a rounder one: two digits at least
    near |= np.isclose(shown[:, 0], value, rtol=1e-12, atol=0)  # the same without its trailing zeros
    if percent:
        near |= np.abs(100 * shown[:, 0] - value) <= 0.5 * 10.0**-decimals
    return bool(near.any())


def shown_by(texts: Iterable[str]) -> np.ndarray:
    """Return the numbers of texts as (n,2)."""
    pairs = {number[:2] for text in texts for _, number in numbers(text)}
    return np.array(sorted(pairs), dtype=float).reshape(-1, 2)


def claims() -> list[dict[str, str]]:
    """Return the claims that the notebooks make today: results/claims/*.csv."""
    found = []
    for path in sorted((ROOT / "results" / "claims").glob("*.csv")):
        found += [
            row | {"file": path.stem} for row in csv.DictReader(path.open(encoding="utf-8", newline=""))
        ]
    return found


def check_cells() -> Iterator[tuple[str, str]]:
    """Yield (key, sentence) of each cell with a number that its notebook and its claims no longer show."""
    with gzip.open(HERE / "cells.csv.gz", "rt", encoding="utf-8", newline="") as file:
        wanted = list(csv.reader(file))
    stems = {path.stem: path for path in sorted((ROOT / "notebooks").glob("*.ipynb"))}
    said = claims()
    shown = {
        stem: shown_by(
            [*texts_of(path)]
            + [row[name] for row in said if row["file"] == stem for name in ("what", "ours", "paper")]
        )
        for stem, path in stems.items()
    }
    moved: Counter[tuple[str, str]] = Counter()
    for stem, row, column, text in wanted:
        new = stem if stem in shown else next((each for each in shown if each[:2] == stem[:2]), stem)
        lost = [word for word, number in numbers(text) if new not in shown or not same(number, shown[new])]
        if not lost:
            continue
        others = [each for each in shown if all(same(n, shown[each]) for _, n in numbers(" ".join(lost)))]
        if others and max(len(word.lstrip("-.0")) for word in lost) > 2:
            moved[stem, others[0]] += 1
            continue
        where = " / ".join(each for each in (row, column) if each)
        yield f"{stem}: {where}", f"{stem}: {where}: {text!r} has {', '.join(lost)}"
    for (stem, other), count in moved.items():
        print(f"  note: {count} cells of {stem} are shown by {other}")


def check_pairs() -> Iterator[tuple[str, str]]:
    """Yield each statement of the old book that no claim makes, or that a claim makes otherwise."""
    said = claims()
    if not said:
        print("  note: results/claims/ has no CSV yet, nothing to compare")
        return
    by_key = {(row["item"], row["what"]): row for row in said}
    for old in csv.DictReader((HERE / "pairs.csv").open(encoding="utf-8", newline="")):
        key = f"{old['item']}: {old['what']}"
        new = by_key.get((old["item"], old["what"]))
        if new is None:  # other words, the same numbers?
            alike = [row for row in said if row["item"] == old["item"] and agrees(old, row)]
            if not alike:
                yield key, f"{key}: no such claim (ours {old['ours']}, paper {old['paper']}, {old['holds']})"
        elif not agrees(old, new):
            now = ", ".join(new[name] for name in ("ours", "paper", "holds"))
            yield key, f"{key}: was {old['ours']}, {old['paper']}, {old['holds']}; is {now}"


def agrees(old: dict[str, str], new: dict[str, str]) -> bool:
    """Whether a claim has the numbers (to the printed digits), or the words, and verdict of an old one."""
    for name in ("ours", "paper"):
        wanted, shown = numbers(old[name]), shown_by([new[name]])
        if not all(same(number, shown) for _, number in wanted):
            return False
        if not wanted and old[name].casefold() != new[name].casefold():
            return False
    truth = {"yes": "yes", "true": "yes", "no": "no", "false": "no"}
    return truth.get(old["holds"].lower(), old["holds"]) == truth.get(new["holds"].lower(), new["holds"])


def check_records() -> Iterator[tuple[str, str]]:
    """Yield each committed record that is gone or has other bytes."""
    for line in (HERE / "runs.sha256").read_text(encoding="utf-8").splitlines():
        digest, name = line.split()
        path = ROOT / "results" / "runs" / name
        if not path.exists():
            yield name, f"{name} is gone"
        elif hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            yield name, f"{name} has other bytes"


def help_text(*words: str) -> str:
    """Return `python -m paper_artifact WORDS --help`."""
    command = [sys.executable, "-m", "paper_artifact", *words, "--help"]
    found = subprocess.run(
        command, capture_output=True, text=True, cwd=ROOT, env=os.environ | {"COLUMNS": "300"}
    )
    return found.stdout


def check_help() -> Iterator[tuple[str, str]]:
    """Yield each verb and option that is gone."""
    for verb, options in json.loads((HERE / "help.json").read_text(encoding="utf-8")).items():
        text = help_text(verb)
        if "--help" not in text:
            yield verb, f"the verb {verb} is gone"
            continue
        now = set(re.findall(r"(?<![\w-])--[a-z][\w-]*", text))
        for option in sorted(set(options) - now):
            yield f"{verb} {option}", f"{verb} has no {option}"


# Name → arguments of `python -m paper_artifact`, in order, in one folder; {mesh}: a torus made here, {bob}: a
# committed soup. All of it takes about a minute of CPU.
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
    "dumps",
    "losses",
    "topology",
    "statement",
    "bundle",
    "images",
    "tails",
    "soup",
    "mesh",
    "scene",
    "frame",
)
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
        name = str(path.relative_to(folder))
        if path.parent.name == "runs":
            record = json.loads(path.read_text(encoding="utf-8"))
            found |= {
                f"{name}: {part}": short(json.dumps(record[part], sort_keys=True).encode())
                for part in SECTIONS
                if part in record
            }
        elif path.parent.name == "soups":
            with np.load(path) as arrays:
                found[name] = short(b"".join(arrays[each].tobytes() for each in sorted(arrays.files)))
        elif (
            path.parts[-2] in ("targets", "checkpoints")
            or "scenes" in path.parts
            or path.name.startswith(".")
        ):
            continue
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


def machine() -> str:
    """Return the kind of processor that the bits hold for: all x86-64 ones with FMA."""
    import platform

    return platform.machine()


def check_runs(only: str = "") -> Iterator[tuple[str, str]]:
    """Yield each short run, by section, whose digest is another."""
    kept = json.loads((HERE / "digests.json").read_text(encoding="utf-8"))
    if machine() != kept["machine"]:
        print(
            f"  note: the digests were made on {kept['machine']}; this is {machine()}, whose bits may differ"
        )
        return
    for name, parts in retrain(only).items():
        wanted = kept["runs"][name]
        differs = [part for part in wanted if parts.get(part) != wanted[part]]
        if differs:
            yield name, f"{name}: {', '.join(differs)}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    checks = {
        "cells": check_cells,
        "pairs": check_pairs,
        "records": check_records,
        "help": check_help,
        "runs": check_runs,
    }
    parser.add_argument("what", nargs="?", default="all", choices=[*checks, "all"])
    parser.add_argument("--only", default="", help="cells, pairs: keys with this; runs: names that match")
    given = parser.parse_args()
    intended = list(csv.DictReader((HERE / "intended.csv").open(encoding="utf-8", newline="")))
    bad = 0
    for what, check in checks.items():
        if given.what not in (what, "all"):
            continue
        print(f"{what}:")
        meant = 0
        found = check_runs(given.only) if what == "runs" else check()
        for key, sentence in found:
            if any(row["check"] == what and re.fullmatch(row["key"], key) for row in intended):
                meant += 1
            elif what == "runs" or given.only in key:
                bad += 1
                print(f"  {sentence}")
        print(f"  {bad} differ so far, {meant} differ as intended.csv says")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
