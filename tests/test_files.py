"""Files: nothing of the user's is removed, killed work is cleared, live work is not, the umask holds."""

import fcntl
import json
import os
import shutil
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import Pipe, get_context
from pathlib import Path

import pytest

from paper_artifact import files
from paper_artifact.catalogue import study_config
from paper_artifact.errors import InputError
from paper_artifact.files import (
    MANIFEST,
    PARTIAL,
    atomic_path,
    check_writable,
    partial_folder,
    renewed_folder,
    write_text,
)
from paper_artifact.notebooks import figures_of
from paper_artifact.scene.build import SceneConfig, build_scene
from paper_artifact.scene.folder import whole_folder
from paper_artifact.scene.shapes import find_mesh, make_shape
from paper_artifact.topology.bundle import load_bundle
from paper_artifact.train.state import alone, resumed_state
from tests.tiny_run import find_records

pytestmark = pytest.mark.faults

THEIRS = "is there and was not written by this command"
TINY = SceneConfig(views=2, size=8, supersample=1, points=4)
WAYS = {
    "file": atomic_path,
    "folder": lambda path: renewed_folder(path, "x"),
    "scene": lambda path: whole_folder(path, "k"),
}


def write(way: str, path: Path, halfway=lambda: None) -> None:
    with WAYS[way](path) as new:
        new = new if way == "file" else new / "deep" / "file"
        new.parent.mkdir(exist_ok=True)
        new.write_text("half")
        halfway()


@contextmanager
def writing(way: str, path: Path):
    """A process that has written half of `path` and goes on within the block; then it is killed."""
    ours, theirs = Pipe()
    process = get_context("fork").Process(
        target=write, args=(way, path, lambda: (theirs.send("writing"), time.sleep(60)))
    )
    process.start()
    theirs.close()  # so that a process that dies is an end of file, not a wait
    try:
        assert ours.recv() == "writing"
        yield
    finally:
        process.kill()
        process.join()


def partials(folder: Path) -> list[Path]:
    return list(folder.rglob(f"{PARTIAL}*"))


def files_in(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()} - {MANIFEST}


def renew(folder: Path, *names: str, part: str = "book", known: bool = False) -> None:
    with renewed_folder(folder, part, names if known else None) as new:
        for name in names:
            write_text(new / name, f"of {part}")


def test_a_folder_is_cleared_only_of_what_was_written_there(tmp_path):
    renew(tmp_path / "own", "a", "tables/b")
    for name in ("mine", "tables/mine.csv", "sub/folder/mine"):
        write_text(tmp_path / "own" / name, "precious")
    renew(tmp_path / "own", "tables/c")
    assert files_in(tmp_path / "own") == {"mine", "tables/mine.csv", "sub/folder/mine", "tables/c"}
    renew(tmp_path / "own", "d", part="another", known=True)
    renew(tmp_path / "own", "e")
    assert files_in(tmp_path / "own") >= {"d", "e"} and not (tmp_path / "own" / "tables/c").exists()


def refuses(words: str, *arguments, **options) -> None:
    """Check that `renew` refuses what it is given."""
    with pytest.raises(InputError, match=words):
        renew(*arguments, **options)


def test_a_folder_of_others_is_refused_and_stays(tmp_path):
    home = tmp_path / "home"
    write_text(home / "notes" / "thesis.txt", "precious")
    renew(home, "audit.html", part="audit", known=True)
    refuses("thesis.txt is there and was not written by this command; choose a", home, "index.html")
    refuses(f"audit.html {THEIRS}", home, "audit.html", part="other", known=True)
    renew(home, "audit.html", part="audit", known=True)
    assert files_in(home) == {"notes/thesis.txt", "audit.html"} and not partials(tmp_path)
    (home / "a.ply").symlink_to(tmp_path / "nowhere.ply")
    refuses(f"a.ply {THEIRS}", home, "a.ply", part="audit", known=True)


@pytest.mark.parametrize("known", [True, False])
def test_a_file_that_the_user_edited_stays(tmp_path, known):
    renew(tmp_path, "a.ply", "b.ply", known=known)
    write_text(tmp_path / "b.ply", "my edit")
    for names in (("a.ply", "b.ply"), ("a.ply",)):  # one that would be replaced, one that would be removed
        refuses("b.ply was changed since this command wrote it; move it", tmp_path, *names, known=known)
    assert (tmp_path / "b.ply").read_text() == "my edit"
    (tmp_path / "b.ply").unlink()
    renew(tmp_path, "a.ply", known=known)
    listed = json.loads((tmp_path / MANIFEST).read_text())
    of_version_0_2 = {part: [*names] for part, names in listed.items()}
    write_text(tmp_path / MANIFEST, json.dumps(of_version_0_2))
    renew(tmp_path, "c.ply", known=known)
    assert files_in(tmp_path) == {"c.ply"}


def test_writers_into_one_folder_at_once_are_all_listed(tmp_path):
    def export(writer: int) -> None:
        for number in range(10):
            renew(tmp_path, f"{writer}_{number}.ply", part=f"export {writer} {number}", known=True)

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(export, range(3)))
    listed = {name for names in json.loads((tmp_path / MANIFEST).read_text()).values() for name in names}
    assert listed == files_in(tmp_path) and len(listed) == 30


def test_a_file_that_comes_while_a_command_works_is_not_replaced(tmp_path):
    for names in (["mine"], None):
        with pytest.raises(InputError, match=f"mine {THEIRS}"), renewed_folder(tmp_path, "x", names) as new:
            write_text(new / "mine", "of x")
            write_text(tmp_path / "mine", "precious")
        assert (tmp_path / "mine").read_text() == "precious"
        (tmp_path / "mine").unlink()


def test_a_name_that_a_failed_command_claimed_is_still_the_users(tmp_path, monkeypatch):
    renew(tmp_path, "a")
    replace = os.replace

    def failing(old: Path, new: Path) -> None:
        replace(tmp_path / "absent" if Path(old).parent.name == "new" else old, new)

    with pytest.raises(InputError), monkeypatch.context() as patch:
        patch.setattr(os, "replace", failing)
        renew(tmp_path, "a", "b")
    for name, theirs in (("a", "a"), ("b", "")):  # what the first call wrote, or nothing
        assert (tmp_path / name).exists() == bool(theirs)
        write_text(tmp_path / name, "precious")
        refuses("was changed since this command wrote it", tmp_path, "a", "b")
        assert (tmp_path / name).read_text() == "precious"
        (tmp_path / name).unlink()
    renew(tmp_path, "a", "b")
    assert files_in(tmp_path) == {"a", "b"}


def test_a_users_file_of_a_new_name_in_an_old_book_stays(tmp_path):
    renew(tmp_path, "a")
    write_text(tmp_path / "b", "precious")
    refuses(f"b {THEIRS}", tmp_path, "a", "b")
    assert (tmp_path / "b").read_text() == "precious"
    renew(tmp_path, "a", "c")
    assert files_in(tmp_path) == {"a", "b", "c"}


@pytest.mark.parametrize("listed", ["[", '{"book": ["../mine"]}', '{"book": 3}', '{"book": [3]}', "[]"])
def test_a_manifest_that_lies_removes_nothing_outside(tmp_path, listed):
    write_text(tmp_path / "mine", "precious")
    write_text(tmp_path / "own" / MANIFEST, listed)
    try:
        renew(tmp_path / "own", "a")
    except InputError as error:
        assert "lies outside of it" in str(error)
    assert (tmp_path / "mine").read_text() == "precious"


@pytest.mark.parametrize("place", [".", "results", "foreign"])
def test_book_refuses_what_is_no_book(tmp_path, monkeypatch, command, place):
    theirs = {"notebooks/a.ipynb", "results/soups/b.npz", "foreign/tables/c.csv"}
    for name in theirs:
        write_text(tmp_path / name, "precious")
    monkeypatch.chdir(tmp_path)
    said = command(f"book --out {place} --quiet", code=1).err
    assert "was not written by this command; choose a new or an empty folder" in said
    assert files_in(tmp_path) == theirs


def test_figures_of_a_notebook_replace_its_own_and_no_others(tmp_path):
    def draw(name: str, *keys: str) -> None:
        with figures_of(Path(f"{name}.ipynb"), tmp_path / "book" / "figures"):
            for key in keys:
                write_text(Path(f"{os.environ['PAPER_ARTIFACT_FIGURES']}_{key}.svg"), key)

    draw("06", "a", "b")
    draw("06_c", "a")
    renew(tmp_path / "book", "index.html", "figures/07_x.png")
    draw("06", "a")
    draw("07", "x")
    figures = {path.name for path in (tmp_path / "book" / "figures").iterdir()} - {MANIFEST}
    assert figures == {"06_a.svg", "06_c_a.svg", "07_x.png", "07_x.svg"}
    assert (tmp_path / "book" / "index.html").is_file()


@pytest.mark.parametrize("way", WAYS)
def test_what_a_kill_left_goes_with_the_next_write_and_live_work_stays(tmp_path, way):
    runs = tmp_path / "runs"
    place = runs / "x" if way == "folder" else runs
    write_text(place / f"{PARTIAL}of-others" / "mine", "precious")
    with writing(way, runs / "x"):
        write_text(place / "b", "whole")
        assert len(partials(tmp_path)) == 2 and find_records(runs) == []
    assert len(partials(tmp_path)) == 2 and find_records(runs) == []
    (place / "b").unlink()
    write(way, runs / "x")
    assert partials(tmp_path) == [place / f"{PARTIAL}of-others"]


def test_files_and_folders_have_the_rights_that_the_user_wants(tmp_path):
    for mask in (0o077, 0o002, 0o027):
        text, before = tmp_path / f"{mask}.txt", os.umask(mask)
        try:
            write_text(text, "a")
            scene = build_scene(make_shape("cube"), TINY, tmp_path / f"{mask}")
        finally:
            os.umask(before)
        written = [text, scene, *scene.rglob("*")]
        assert {rights(path) for path in written if path.is_dir()} == {0o777 & ~mask}
        assert {rights(path) for path in written if path.is_file()} == {0o666 & ~mask}


def rights(path: Path) -> int:
    return path.stat().st_mode & 0o777


def test_a_file_that_is_replaced_keeps_its_rights(tmp_path):
    write_text(tmp_path / "a", "private")
    (tmp_path / "a").chmod(0o600)
    write_text(tmp_path / "a", "again")
    assert rights(tmp_path / "a") == 0o600


def test_a_folder_of_the_users_that_looks_temporary_stays(tmp_path):
    for name in (".partial-thesis", ".partial-empty"):
        (tmp_path / name).mkdir()
    (tmp_path / ".partial-thesis" / "lock").write_text("")
    write_text(tmp_path / "new", "x")
    assert len(list(tmp_path.iterdir())) == 3


def test_a_link_is_followed_and_a_pipe_refused(tmp_path):
    (tmp_path / "link").symlink_to("real")
    write_text(tmp_path / "real", "old")
    write_text(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "real").read_text() == "new"
    os.mkfifo(tmp_path / "pipe")
    for act in (lambda path: write_text(path, "x"), load_bundle):
        with pytest.raises(InputError, match="a device or a pipe"):
            act(tmp_path / "pipe")
    assert (tmp_path / "pipe").is_fifo()
    (tmp_path / "circle").symlink_to("circle")
    with pytest.raises(InputError, match="a link in a circle"):
        write_text(tmp_path / "circle", "x")
    assert (tmp_path / "circle").is_symlink()
    with pytest.raises(InputError, match="pipe is a pipe or a device; save"):
        find_mesh(str(tmp_path / "pipe"))


def test_a_write_protected_file_is_not_replaced(tmp_path, monkeypatch):
    write_text(tmp_path / "mine", "precious")
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "mine")  # root may always
    for act in (lambda path: write_text(path, "x"), check_writable):
        with pytest.raises(InputError, match="mine: it is write-protected"):
            act(tmp_path / "mine")
    assert (tmp_path / "mine").read_text() == "precious"


def test_a_name_that_no_file_can_have_is_a_sentence(tmp_path):
    with pytest.raises(InputError, match="cannot write .*File name too long"):
        write_text(tmp_path / ("x" * 300), "a")
    with pytest.raises(FileNotFoundError), atomic_path(tmp_path / "a"):
        (tmp_path / "absent").read_bytes()


def test_a_scene_takes_the_place_behind_a_link_and_not_that_of_the_current_folder(tmp_path, monkeypatch):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    build_scene(make_shape("cube"), TINY, tmp_path / "link")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "real" / "scene.json").is_file()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(InputError, match="is the current folder or a mount point; name a folder in it"):
        build_scene(make_shape("cube"), TINY, Path("."))


def build(folder: str) -> str:
    """Build a scene and say what went wrong, "" for nothing."""
    try:
        build_scene(make_shape("cube"), TINY, Path(folder))
        json.loads((Path(folder) / "scene.json").read_text())
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


def built_by_four(folder: Path, scenes: int) -> set[str]:
    """Let four processes at once build each of the scenes; return what went wrong, {""} for nothing."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["tests.test_files"])
    places = [str(folder / f"my-{index}") for index in range(scenes) for _ in range(4)]
    with ProcessPoolExecutor(4, mp_context=context) as pool:
        return set(pool.map(build, places))


def test_four_processes_build_one_scene(tmp_path):
    assert built_by_four(tmp_path, 2) == {""} and len(list(tmp_path.iterdir())) == 2


if __name__ == "__main__":  # python -m tests.test_files BUILDS
    with tempfile.TemporaryDirectory() as place:
        wrong = built_by_four(Path(place), int(sys.argv[1]) // 4)
        print(len(os.listdir(place)), "scenes,", "; ".join(wrong - {""}) or "no failure")
        sys.exit(wrong != {""})


def test_a_file_that_has_the_name_of_a_runs_lock_stays(tmp_path):
    for text in ("", "mine"):
        (tmp_path / "run.lock").write_text(text)
        with alone(tmp_path / "run.pt"):
            pass
        assert (tmp_path / "run.lock").exists() == (text != "")


def test_a_kill_while_a_partial_folder_is_removed_leaves_its_lock_last(tmp_path, monkeypatch):
    order = []
    for name in ("rmtree", "unlink", "rmdir"):
        owner = shutil if name == "rmtree" else Path
        act = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda path, act=act: (order.append(Path(path).name), act(path))[1])
    with partial_folder(tmp_path) as folder:
        (folder / "new").mkdir()
        (folder / "a").touch()
    assert {*order[:2]} == {"new", "a"} and order[2:] == ["lock", folder.name] and not folder.exists()


def test_a_link_named_like_a_partial_folder_and_what_it_points_to_stay(tmp_path):
    for name in ("lock", "mine"):
        write_text(tmp_path / "owned" / name, "x")
    (tmp_path / f"{PARTIAL}link").symlink_to("owned")
    write_text(tmp_path / "new", "x")
    assert sorted(each.name for each in (tmp_path / "owned").iterdir()) == ["lock", "mine"]
    assert (tmp_path / f"{PARTIAL}link").is_symlink()


def test_a_pipe_in_a_checkpoints_place_is_refused(tmp_path):
    os.mkfifo(tmp_path / "run.pt")
    with pytest.raises(InputError, match="it is a device or a pipe"):
        resumed_state(tmp_path / "run.pt", study_config("sphere", "C0"), None, None)


def test_a_folder_that_another_program_keeps_locked_is_told_before_anything_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "PATIENCE", 0.2)
    (out := tmp_path / "out").mkdir()
    lock = os.open(out, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    words = "another program keeps .*out locked; end it, or choose another"
    with pytest.raises(InputError, match=words), renewed_folder(out, "part"):
        raise AssertionError("the block was entered")
    os.close(lock)
    with renewed_folder(out, "part") as new:
        (new / "a").write_text("a")
    assert (out / "a").read_text() == "a"


@pytest.mark.parametrize("way", WAYS)
def test_a_temporary_folder_that_somebody_removes_is_told(tmp_path, way):
    words = "was removed while this command worked in it; run it again"
    with pytest.raises(InputError, match=words), WAYS[way](tmp_path / "made") as temporary:
        shutil.rmtree(next(tmp_path.rglob(f"{PARTIAL}*")))
        (temporary / "a").write_text("a")
