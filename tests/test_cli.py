"""The command line: registry, help, options, exit codes, terminals; verbs are tested with their rooms."""

import importlib
import json
import os
import shlex
import signal
import subprocess
import sys
import time
import types
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import pytest
import trimesh

from paper_artifact import cli
from paper_artifact.cli import bars, output
from paper_artifact.cli.options import Options, Positional, Source, read_options, words_of
from paper_artifact.config import RunConfig
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.record.store import config_hash, record_path

COMMAND = [sys.executable, "-m", "paper_artifact"]
SIZES = {"small": 1, "large": 2}


def shell(script: str, cwd: Path = REPOSITORY, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a line of bash in which PY is the command."""
    known = {**os.environ, "PYTHONPATH": str(REPOSITORY), "PY": shlex.join(COMMAND)} | environment
    texts = {"capture_output": True, "text": True, "errors": "replace"}
    return subprocess.run(["bash", "-c", script], cwd=cwd, timeout=300, env=known, **texts)


@dataclass(frozen=True, kw_only=True)
class Trial(Options):
    """Options of a verb for the tests.

    place FILE: a file
    number: a number
    size: one of {SIZES} 100 % known
    several: words
    changes/set NAME=VALUE: may be given
        several times
    json FILE: where to write
    """

    place: Positional[Source | None] = None
    number: Annotated[int, 2, 9] | None = None
    size: Annotated[str, tuple(SIZES)] = "small"
    several: tuple[int, ...] = (1, 2)
    changes: list[str] = field(default_factory=list)
    json: Path | None = None


@pytest.fixture
def verb(monkeypatch):
    """Register a verb `trial`; returns a setter for what it does."""
    module = types.ModuleType("paper_artifact.cli.trial")
    monkeypatch.setitem(cli.VERBS, "trial", ("trial.run", "a verb for the tests"))
    monkeypatch.setitem(sys.modules, "paper_artifact.cli.trial", module)

    def set_run(run):
        def runner(options: Trial):
            return run(options)

        runner.__annotations__["options"] = Trial
        module.run = runner

    return set_run


def test_help_names_every_verb_and_imports_none_of_them():
    result = shell(f"{sys.executable} -X importtime -m paper_artifact --help")
    assert result.returncode == 0
    assert all(name in result.stdout for name in cli.VERBS)
    imported = {line.rsplit("|", 1)[-1].strip() for line in result.stderr.splitlines()}
    assert "paper_artifact.cli" in imported
    assert not imported & {"numpy", "torch", "numba", "scipy", "tqdm", "pandas", "matplotlib"}


@pytest.mark.parametrize("name", cli.VERBS)
def test_each_verb_explains_itself(name, command):
    text = " ".join(command(f"{name} --help").out.split())
    assert f"paper_artifact {name}" in text and "--quiet" in text
    assert cli.VERBS[name][1].lower() in text.lower()


def test_options_are_what_the_fields_say(verb, command):
    seen = []
    verb(lambda options: (seen.append(options) or 3, {"a": 1}))
    command("trial x.obj --number 7 --several 4 5 --set a=1 --set b=2 --size large", code=3)
    (got,) = seen
    assert (got.place, got.number, got.several, got.changes) == ("x.obj", 7, (4, 5), ["a=1", "b=2"])
    assert got.quiet, "without a terminal there are no bars"
    text = " ".join(command("trial --help").out.split())
    assert "--set NAME=VALUE may be given several times" in text and "(default: 1 2)" in text
    assert "one of small, large 100 % known" in text and "[FILE]" in text


@pytest.mark.parametrize(
    "line, words",
    [
        ("", "usage:"),
        ("nope", "usage:"),
        ("fetch --nope", "usage:"),
        ("trial --number many", "usage:"),
        ("trial --size huge", "usage:"),
        ("trial --number 10", "--number must be from 2 to 9, got 10"),
        ("trial " + "x" * 300, "place names a file by 300 bytes"),
        ("trial --json " + "ε" * 120, "--json names a file by 240 bytes"),
        ("trial " + "/".join(["x" * 99] * 50), "too long for a file system"),
    ],
)
def test_wrong_usage_is_exit_code_2(line, words, verb, command):
    verb(None)  # calling it would fail
    assert words in command(line, code=2).err


@pytest.mark.parametrize(
    "error, words",
    [
        (InputError("the mesh a.obj is empty; give another"), "the mesh a.obj is empty"),
        (KeyboardInterrupt(), "interrupted"),
        (MemoryError(), "needs more memory than there is"),
        (OSError(36, "File name too long", "y" * 300), "is too long for a file system"),
        (OSError(28, "No space left on device", "a.ply"), "write a.ply: No space left on device; free"),
        (OSError(27, "File too large", "a.ply"), "File too large; raise the file size limit (ulimit -f)"),
        (PermissionError(13, "Permission denied", "a.ply"), "a.ply: Permission denied; check the rights"),
        (ModuleNotFoundError("No module named 'torch'", name="torch"), "needs the Python package 'torch'"),
    ],
)
def test_failure_is_one_line_and_exit_code_1(error, words, verb, command):
    def run(options):
        raise error

    verb(run)
    text = command("trial", code=1).err
    assert words in text and len(text.splitlines()) == 1


def test_a_fault_of_our_own_keeps_its_trace(verb):
    verb(lambda options: {}["missing"])
    with pytest.raises(KeyError):
        cli.main(["trial"])


def test_json_goes_to_a_file_or_alone_to_stdout(verb, tmp_path, command):
    verb(lambda options: print("a table") or (0, {"β": [1, 2]}))
    assert command("trial --json", tmp_path / "a.json").out == "a table\n"
    assert json.loads((tmp_path / "a.json").read_text()) == {"β": [1, 2]}
    out, error = command("trial --json -")
    assert json.loads(out) == {"β": [1, 2]} and error == "a table\n"


def test_a_table_sets_numbers_right_and_texts_left():
    table = output.to_string(("what", "n"), [("a", 5), ("longer", 12345)], "  ")
    assert table.splitlines() == ["  what        n", "  a           5", "  longer  12345"]
    assert output.to_string(("a", "bb"), []) == "a  bb"


@pytest.mark.parametrize("name", ["my soup.npz", "it's; rm -rf ~", "$HOME `id`", "-x", "a\nb", '"ε"'])
def test_next_commands_survive_copy_and_paste(name):
    line = output.next_command("export", name)
    given = f"./{name}" if name == "-x" else name  # no program takes it for an option
    assert shlex.split(line)[1:] == ["python", "-m", "paper_artifact", "export", given]


@pytest.mark.parametrize("name", ["-x", "n" * 214, "ε" * 100])
def test_proposed_commands_and_names_work_for_odd_names(name, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2]]).export("a.obj")
    Path("a.obj").rename(f"{name}.obj")
    following = command("certify --closed --", f"{name}.obj", code=1).out.splitlines()[-1]
    words = shlex.split(following)[4:]
    assert words[0] == "ingest" and command("", *words) and Path(words[-1]).is_file()
    config = RunConfig(f"{name}.obj")
    path = record_path(config)
    assert len(os.fsencode(path.name)) < 200 and path.name.endswith(f"{config_hash(config)}.json")


def test_the_words_of_options_give_them_again():
    line = "sweep torus --seed 3 --seed 4 --set budget=60 --set views=8 --list --steps 20 --holdout a.jpg"
    parser, runner = cli._parser("sweep")
    options = read_options(cli._options_of(runner), parser.parse_args(shlex.split(line)))
    again = ["sweep", *map(str, words_of(options))]
    assert read_options(type(options), parser.parse_args(again)) == options and "--list" in again
    assert "--list" not in words_of(options, "listing")


def test_warnings_are_one_line_and_those_of_numbers_none(tmp_path):
    code = (
        "import numpy as np, warnings; from paper_artifact.cli.output import prepare_streams as p; p();"
        "np.array([1e308]) * 10; warnings.warn('a word')"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stderr == "warning: a word\n"


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "latin-1"])
def test_terminals_that_lack_a_sign_get_plain_letters(encoding):
    code = (
        "from paper_artifact.cli.output import prepare_streams as p; p(); print('ε = β × χ ← \\udce9 ü');"
        "import sys; print('λ…', file=sys.stderr)"
    )
    result = shell(f'{sys.executable} -c "$CODE"', CODE=code, PYTHONIOENCODING=encoding, LC_ALL="C")
    assert result.returncode == 0, result.stderr
    assert "eps = beta " in result.stdout and "<- \ufffd" in result.stdout and "lambda" in result.stderr


@pytest.mark.parametrize(
    "script, code, words",
    [
        ("$PY certify cube >&-", 0, ""),  # stdout is closed
        ("$PY certify cube >&- 2>&-", 0, ""),
        ("$PY certify cube > /dev/full", 1, "cannot write"),
        ("PYTHONUNBUFFERED= ${PY} train --help > /dev/full", 1, "cannot write"),
        ("${PY} sweep table1 --list > /dev/full", 1, "the output: No space left on device; free some space"),
        ("$PY certify cube 1</dev/null", 1, "the output: Bad file descriptor; open it for writing"),
        ("cat /dev/null | $PY certify /dev/stdin", 1, "/dev/stdin is a pipe or a device; save the mesh in a"),
        ("$PY train --help | head -n 1", 0, ""),
        ("PYTHONIOENCODING=ascii $PY certify cube", 0, ""),
        ("LC_ALL=de_DE.UTF-8 LC_NUMERIC=de_DE.UTF-8 $PY certify cube", 0, ""),  # 0,5 for .5
        ("PYTHONWARNINGS=ignore $PY certify open_box", 1, "unknown shape 'open_box'"),
    ],
)
def test_odd_terminals_and_surroundings(script, code, words):
    unbuffered = script.replace("$PY", shlex.join([sys.executable, "-u", "-m", "paper_artifact"]))
    result = shell(unbuffered)  # ${PY} is not
    assert result.returncode == code and words in result.stderr, result.stderr
    assert len(result.stderr.splitlines()) == (words != "")


def test_files_are_written_when_the_reader_of_the_text_has_gone(tmp_path):
    result = shell("PYTHONUNBUFFERED=1 $PY certify cube --json a.json 2>&1 | true", tmp_path)
    assert result.returncode == 0 and json.loads((tmp_path / "a.json").read_text())["betti"] == [1, 0, 1]


def test_a_working_directory_that_is_gone(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    result = shell(f"rmdir {gone}; $PY certify cube --json {tmp_path}/a.json", gone)
    assert result.stderr == "paper_artifact: the current folder was deleted; change to one that exists\n"
    assert result.returncode == 1


def test_the_bar_of_steps_shows_no_rate_before_the_first():
    with bars.step_bar("sphere C0", 100, False) as line:
        assert "preparing scene and kernels" in line.format_meter(**line.format_dict)
        assert "?" not in str(line) and not line.seen
        line.start_t -= 3600  # an hour of compiling
        line.progress(41, "loss .1")
        assert line.initial == 41 and line.seen
        assert line.format_dict["elapsed"] < 60, "the time left is of the steps alone"
    with bars.step_bar("sphere C0", 100, True) as line:
        line.progress(1, "loss .1")
        assert line.seen


def test_tab_completion_proposes_verbs_options_and_names(tmp_path):
    def proposed(line: str) -> set[str]:
        script = 'exec 8>"$OUT" 9>/dev/null; $PY'
        known = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_SHELL": "bash", "COMP_LINE": line, "COMP_TYPE": "9"}
        known |= {"COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": "\n", "OUT": str(tmp_path / "out")}
        shell(script.replace("$PY", shlex.join(COMMAND)), **known)
        return {each.strip() for each in (tmp_path / "out").read_text().split("\n")}

    assert {"certify", "ingest"} <= proposed("paper-artifact ")
    assert proposed("paper-artifact certify --c") >= {"--closed", "--cut"}
    assert "two_spheres" in proposed("paper-artifact train two_")


SWALLOWS = """import os, signal, time
try:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.2)
except BaseException:
    pass
"""


def raises_another(argv, asked):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)
    except KeyboardInterrupt:
        raise ImportError("PLEASE READ THIS") from None


def imports(argv, asked):
    importlib.import_module("swallows")
    for _ in range(500):
        time.sleep(0.01)


def calls_back(argv, asked, module="llvmlite.binding"):
    exec(SWALLOWS, {"__name__": module})
    for _ in range(500):
        time.sleep(0.01)


forgets = partial(calls_back, module="weakref")  # a key's callback, whose errors are printed and passed over


@pytest.mark.parametrize("work", (raises_another, imports, calls_back, forgets))
def test_an_interrupt_that_a_library_swallows_or_turns_into_another_error_is_one(
    work, monkeypatch, capsys, tmp_path
):
    (tmp_path / "swallows.py").write_text(SWALLOWS)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(cli, "_run", work)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert cli.main(["certify", "torus"]) == 1
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
        sys.modules.pop("swallows", None)
    assert capsys.readouterr().err.startswith("paper_artifact: interrupted; ")


@pytest.mark.parametrize(
    "name, value, code, words",
    [
        ("NUMBA_NUM_THREADS", "0", 2, "NUMBA_NUM_THREADS is 0; unset it, or set it to 1 or more"),
        ("PAPER_ARTIFACT_MIRROR", "~nobodyx/meshes", 1, "the mirror ~nobodyx/meshes is no folder"),
        ("MPLBACKEND", "Qt4Agg", 0, ""),
        ("TQDM_NCOLS", "wide", 0, ""),
    ],
)
def test_odd_variables_are_a_sentence_or_nothing(name, value, code, words, tmp_path, monkeypatch, command):
    monkeypatch.setenv(name, value)
    line = f"fetch cow --out={tmp_path}" if code == 1 else "certify torus"
    assert words in command(line, code=code).err
    assert not {"MPLBACKEND", "TQDM_NCOLS"} & {*os.environ}


def test_an_empty_name_is_not_the_current_folder(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    said = command("audit torus --out ''", code=2).err
    assert "argument --out: the name is empty; is a variable of the shell not set?" in said
    assert "the name is empty" in command("photos '' --out x", code=2).err
    assert not [*tmp_path.iterdir()]


def test_a_path_through_a_folder_that_is_not_there(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    said = command("scene --shape sphere --views 2 --size 22 --out missing/../b", code=2).err
    assert "--out missing/../b leads through missing, which is not there" in said
    Path("there").mkdir()
    command("scene --shape sphere --views 2 --size 22 --out there/../b")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b", "there"]


def test_a_home_that_cannot_be_written_is_no_matter_of_the_figures(tmp_path):
    code = "from paper_artifact.cli import main; main(['fetch', '--list']); import matplotlib"
    home = {"HOME": "/proc/none", "MPLCONFIGDIR": "/proc/none", "TMPDIR": str(tmp_path)}
    ended = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | home, cwd=REPOSITORY, capture_output=True, text=True
    )
    assert ended.returncode == 0 and ended.stderr == ""


def test_outputs_of_certify_are_tried_first_and_proposed_where_nothing_is(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    said = command(f"certify torus --cut 1 --out {tmp_path}/file/x.ply", code=1)
    assert "cannot write" in said.err and said.out == ""
    Path("open.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 1\nf 1 2 3\nf 1 2 4\nf 1 2 3\n")
    for name in ("open_shell.ply", "open_shell-2.ply"):
        assert f"--out {name}" in command("certify open.obj", code=1).out
        Path(name).touch()
