"""Fetching, against a local server and local mirrors: a failure leaves nothing behind and says what to do."""

import hashlib
import os
import socket
import threading
import zipfile
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from pathlib import Path

import pytest

from paper_artifact.cli import scenes  # noqa: F401, its names are patched
from paper_artifact.errors import InputError
from paper_artifact.files import LOCK, PARTIAL
from paper_artifact.scene import fetch as fetching
from paper_artifact.scene.fetch import ROLES, photo_sets, sources

BODY = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n" * 400
HEADER = "key,name,repository,commit,path,sha256,bytes,licence,role,member,member_sha256,notes\n"
PHOTO_HEADER = "set,repository,commit,path,sha256,bytes,licence\n"
VIEWS = {"views/a.png": b"first", "views/b.png": b"second"}


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _zip(name: str, data: bytes) -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(name, data)
    return buffer.getvalue()


ARCHIVE = _zip("deep/tri.ply", BODY)


@pytest.fixture(autouse=True)
def tables(tmp_path, monkeypatch):
    """Tables with a plain mesh, two archives and a set of photographs; no mirror in the environment."""
    text = HEADER + "gone,gone,,,,,,,not obtainable,,,nowhere to be found\n"
    for key, file, data, member, digest in (
        ("tri", "data/a b.obj", BODY, "", ""),
        ("packed", "data/packed.zip", ARCHIVE, "deep/tri.ply", _sha(BODY)),
        ("another", "data/packed.zip", ARCHIVE, "deep/tri.ply", _sha(b"")),
    ):
        text += f"{key},{key},some/where,abc,{file},{_sha(data)},{len(data)},CC0,used,{member},{digest},\n"
    (tmp_path / "meshes.csv").write_text(text)
    rows = [f"two,some/where,abc,{path},{_sha(data)},{len(data)},free\n" for path, data in VIEWS.items()]
    (tmp_path / "photographs.csv").write_text(PHOTO_HEADER + "".join(rows))
    meshes, sets = sources(tmp_path / "meshes.csv"), photo_sets(tmp_path / "photographs.csv")
    for module in ("paper_artifact.scene.fetch", "paper_artifact.cli.scenes"):
        monkeypatch.setattr(f"{module}.sources", lambda: meshes)
        monkeypatch.setattr(f"{module}.photo_sets", lambda: sets)
    monkeypatch.delenv(fetching.MIRROR_VARIABLE, raising=False)


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


@pytest.fixture
def server(monkeypatch):
    """A context with a server on 127.0.0.1 that answers every GET alike; yields the requested paths."""

    @contextmanager
    def run(status: int = 200, body: bytes = BODY, announced: int | None = None):
        asked: list[str] = []

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                asked.append(self.path)
                self.send_response(status)
                self.send_header("Content-Length", str(len(body) if announced is None else announced))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *arguments):
                pass

        with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as running:
            thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
            thread.start()
            monkeypatch.setattr(fetching, "RAW", f"http://127.0.0.1:{running.server_address[1]}")
            try:
                yield asked
            finally:
                running.shutdown()
                thread.join()

    return run


def get(key: str, out: Path, mirror: Path | None = None):
    return fetching.fetch(key, mirror, out, quiet=True)


def files_below(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def mirror_with(folder: Path, files: dict[str, bytes]) -> Path:
    folder.mkdir()
    for path, data in files.items():
        file = folder / "some+where" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    return folder


def test_a_download_lands_whole_and_what_was_changed_is_not_replaced(out, server):
    with server() as asked:
        first, second = get("tri", out), get("tri", out)
        assert (first.origin, second.origin) == (fetching.RAW + asked[0], "already there")
        assert asked == ["/some/where/abc/data/a%20b.obj"]
        assert first.path == out / "some+where" / "data" / "a b.obj" and first.path.read_bytes() == BODY
        first.path.write_bytes(BODY[:-1])
        with pytest.raises(InputError, match="is no longer the file that was fetched"):
            get("tri", out)
        assert first.path.read_bytes() == BODY[:-1]
        first.path.unlink()
        left = first.path.parent / f"{PARTIAL}killed"
        left.mkdir()
        (left / LOCK).touch()
        (left / "a b.obj").write_bytes(BODY[:9])
        assert get("tri", out).path.read_bytes() == BODY and len(asked) == 2
    assert files_below(out) == [first.path]
    (out / "plain").touch()
    assert first.path.stat().st_mode == (out / "plain").stat().st_mode  # as the umask has it


def test_an_archive_is_kept_and_unpacked_beside_itself(out, server):
    with server(body=ARCHIVE) as asked:
        path = get("packed", out).path
        path.unlink()
        assert get("packed", out).path.read_bytes() == BODY
        path.unlink()
        with pytest.raises(InputError, match="not the pinned one"):
            get("another", out)
    assert path == out / "some+where" / "data" / "tri.ply" and len(asked) == 1


@pytest.mark.parametrize(
    "answer, words",
    [
        ({"status": 404}, "answers 404"),
        ({"status": 503}, "answers 503"),
        ({"body": BODY[:1000], "announced": len(BODY)}, "broke off|not the pinned"),
        ({"body": BODY[:1000]}, "is not the pinned file"),
        ({"body": b"x" * len(BODY)}, "is not the pinned file"),
        ({"body": BODY + b"more"}, "is not the pinned file"),
        ({"body": b""}, "is not the pinned file"),
    ],
)
def test_a_bad_answer_is_one_sentence_and_leaves_nothing(out, server, answer, words):
    with server(**answer), pytest.raises(InputError, match=words) as caught:
        get("tri", out)
    assert "\n" not in str(caught.value) and "'tri'" in str(caught.value) and files_below(out) == []


@pytest.mark.parametrize("listens", [False, True])
def test_no_answer_says_what_to_do(out, monkeypatch, listens):
    monkeypatch.setattr(fetching, "TIMEOUT", 0.2)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        if listens:
            taken.listen()
        monkeypatch.setattr(fetching, "RAW", f"http://127.0.0.1:{taken.getsockname()[1]}")
        with pytest.raises(InputError, match="(broke off|cannot be reached).*--mirror") as caught:
            get("tri", out)
    assert isinstance(caught.value, fetching.Unreachable) != listens and files_below(out) == []


def test_an_interrupted_copy_leaves_nothing(out, tmp_path, monkeypatch):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(fetching.shutil, "copyfile", interrupt)
    with pytest.raises(KeyboardInterrupt):
        get("tri", out, mirror_with(tmp_path / "mirror", {"data/a b.obj": BODY}))
    assert files_below(out) == []


def test_a_named_mirror_comes_before_that_of_the_environment(tmp_path, monkeypatch):
    named, variable = (mirror_with(tmp_path / name, {"data/a b.obj": BODY}) for name in ("named", "variable"))
    monkeypatch.setenv(fetching.MIRROR_VARIABLE, str(variable))
    assert get("tri", tmp_path / "2").origin == str(variable)
    assert get("tri", tmp_path / "3", named).origin == str(named)


@pytest.mark.parametrize(
    "data, words", [(None, "has no readable"), (BODY[:-3], "not the pinned"), (BODY[::-1], "not the pinned")]
)
def test_a_bad_file_of_a_mirror(tmp_path, out, data, words):
    mirror = mirror_with(tmp_path / "mirror", {} if data is None else {"data/a b.obj": data})
    with pytest.raises(InputError, match=words):
        get("tri", out, mirror)
    assert files_below(out) == []


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda path: path.symlink_to("/dev/zero")])
def test_what_is_no_file_in_a_mirror_is_not_copied(tmp_path, out, make):
    mirror = mirror_with(tmp_path / "mirror", {"data/a b.obj": BODY})
    (file := mirror / "some+where" / "data" / "a b.obj").unlink()
    make(file)
    with pytest.raises(InputError, match="mirror .* has no readable"):
        get("tri", out, mirror)
    assert files_below(out) == []


def test_a_mirror_that_is_no_folder_and_a_place_that_cannot_be_written(tmp_path, out):
    with pytest.raises(InputError, match="is no folder"):
        get("tri", out, tmp_path / "none")
    with pytest.raises(InputError, match="not obtainable: nowhere to be found"):
        get("gone", out)
    out.write_text("a file where the folder should be")
    with pytest.raises(InputError, match="cannot write"):
        get("tri", out, mirror_with(tmp_path / "mirror", {"data/a b.obj": BODY}))


def test_a_set_is_fetched_whole_or_says_what_is_missing(tmp_path, out, monkeypatch, command):
    mirror = mirror_with(tmp_path / "mirror", VIEWS | {"views/b.png": b"sec0nd"})
    monkeypatch.setenv(fetching.MIRROR_VARIABLE, str(mirror))
    line = f"fetch two --out {out} --quiet"
    assert "is not the pinned file of 'two/b.png'" in command(line, code=1).err
    (mirror / "some+where/views/b.png").write_bytes(VIEWS["views/b.png"])
    assert f"{out / 'some+where' / 'views'}  ({mirror})" in command(line).out
    assert {f"views/{path.name}": path.read_bytes() for path in files_below(out)} == VIEWS
    assert "already there" in command(line).out and "  free\n" in command("fetch --list").out


def test_the_tables_are_complete_and_pinned(monkeypatch):
    monkeypatch.undo()
    needed = "spot bob rocker-arm fandisk horse armadillo eight cheburashka eight-dense cow ogre teapot beast"
    meshes = fetching.sources()
    assert {*needed.split(), "max-planck"} <= set(meshes)
    counts = {"castle": 11, "lego": 101, "fox": 51, "monstree": 23}
    assert {name: len(each.files) for name, each in photo_sets().items()} == counts
    obtainable = [entry for entry in meshes.values() if entry.obtainable]
    for entry in obtainable + [file for each in photo_sets().values() for file in each.files]:
        assert entry.role in ROLES and len(entry.commit) == 40 and len(entry.sha256) == 64 and entry.bytes > 0
        assert bool(entry.member) == bool(entry.member_sha256) == entry.path.endswith(".zip")
    assert all(each.licence for each in [*obtainable, *photo_sets().values()])
    assert all(len({file.commit for file in each.files}) == 1 for each in photo_sets().values())
    assert len({entry.relative_mesh_path for entry in obtainable}) == len(obtainable)


@pytest.mark.parametrize(
    "read, text, words",
    [
        (sources, "key,name\nspot,spot\n", "line 2 of .* is damaged"),
        (sources, HEADER + "a,a,b/c,d,e,f,many,CC0,used,,,\n", "line 2 of .* is damaged"),
        (sources, HEADER + "a,a,b/c,d,e,f,1,CC0,spare,,,\n", "unknown role"),
        (sources, None, "cannot read .*checkout"),
        (photo_sets, PHOTO_HEADER + "a,b/c,d,e,f,many,g\n", "line 2 of .* is damaged"),
    ],
)
def test_a_damaged_table(tmp_path, read, text, words):
    if text is not None:
        (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        read(tmp_path / "bad.csv")
    assert photo_sets(tmp_path / "none.csv") == {}


def test_the_command_line(tmp_path, out, command, monkeypatch):
    monkeypatch.undo()  # the real table from here on
    monkeypatch.setenv(fetching.MIRROR_VARIABLE, str(tmp_path))
    printed, error = command(f"fetch spot cow --out {out} --quiet", code=1)
    first, _, last = error.splitlines()  # a line for each, and the sum
    assert first.startswith("spot: the mirror ") and "has no readable" in first and "add the file" in first
    assert last == "paper_artifact: 2 of 2 meshes could not be fetched"
    assert printed == "" and not out.exists()
    assert "leave spot out" in command("fetch --list spot", code=2).err
    listed = command("fetch --list").out
    assert all(key in listed for key in fetching.sources()) and "  CC0-1.0" in listed


def test_a_loop_of_links_is_a_sentence(out):
    out.mkdir(parents=True)
    (out / "loop").symlink_to("loop")
    with pytest.raises(InputError, match="cannot write"):
        get("tri", out / "loop")
