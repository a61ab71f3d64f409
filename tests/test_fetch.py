"""Fetching: against a local server and local mirrors, every failure leaves nothing behind and says what to
do.
"""

from __future__ import annotations

import hashlib
import socket
import threading
import zipfile
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from pathlib import Path

import pytest

from paper_artifact.cli import main
from paper_artifact.errors import InputError
from paper_artifact.scene import fetch as fetching
from paper_artifact.scene.fetch import ROLES, TABLE, source, sources

BODY = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n" * 400
HEADER = "key,name,repository,commit,path,sha256,bytes,licence,role,member,member_sha256,notes\n"


def _zip(name: str, data: bytes) -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(name, data)
    return buffer.getvalue()


ARCHIVE = _zip("deep/tri.ply", BODY)


@pytest.fixture(autouse=True)
def table(tmp_path, monkeypatch):
    """A table with one plain mesh and one archive; no mirror in the environment.
    """
    path = tmp_path / "meshes.csv"
    rows = [
        ("tri", "data/a b.obj", BODY, "", ""),
        ("packed", "data/packed.zip", ARCHIVE, "deep/tri.ply", hashlib.sha256(BODY).hexdigest()),
    ]
    path.write_text(
        HEADER
        + "".join(
            f"{key},{key},some/where,abc,{file},{hashlib.sha256(data).hexdigest()},{len(data)},CC0,used,{member},{digest},\n"
            for key, file, data, member, digest in rows
        )
        + "gone,gone,,,,,,,not obtainable,,,nowhere to be had\n"
    )
    monkeypatch.setattr(fetching, "source", lambda key: source(key, path))
    monkeypatch.delenv(fetching.MIRROR_VARIABLE, raising=False)
    return path


@contextmanager
def server(status: int = 200, body: bytes = BODY, announced: int | None = None):
    """A server on 127.0.0.1 that answers every GET alike; yields (base URL, list of requested paths)."""
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
        try:
            yield f"http://127.0.0.1:{running.server_address[1]}", asked
        finally:
            running.shutdown()
            thread.join()


def files_below(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_download_lands_whole_and_is_not_repeated(tmp_path):
    out = tmp_path / "out"
    with server() as (url, asked):
        first = fetching.fetch("tri", downloads=out, base_url=url, quiet=True)
        second = fetching.fetch("tri", downloads=out, base_url=url, quiet=True)
    assert first.path == out / "some+where" / "data" / "a b.obj"
    assert first.path.read_bytes() == BODY
    assert asked == ["/some/where/abc/data/a%20b.obj"]
    assert (first.origin, second.origin) == (url + asked[0], "already there")
    assert files_below(out) == [first.path]


def test_damaged_download_is_fetched_again(tmp_path):
    with server() as (url, asked):
        path = fetching.fetch("tri", downloads=tmp_path, base_url=url, quiet=True).path
        path.write_bytes(BODY[:-1])
        fetching.fetch("tri", downloads=tmp_path, base_url=url, quiet=True)
    assert path.read_bytes() == BODY and len(asked) == 2


def test_archive_is_unpacked_beside_itself(tmp_path):
    with server(body=ARCHIVE) as (url, asked):
        path = fetching.fetch("packed", downloads=tmp_path / "out", base_url=url, quiet=True).path
        path.unlink()
        again = fetching.fetch("packed", downloads=tmp_path / "out", base_url=url, quiet=True)
    assert path == tmp_path / "out" / "some+where" / "data" / "tri.ply"
    assert again.path.read_bytes() == BODY
    assert len(asked) == 1, "the kept archive serves the second time"


@pytest.mark.parametrize(
    "answer, words",
    [
        ({"status": 404}, "answers 404"),
        ({"status": 503}, "answers 503"),
        ({"body": BODY[:1000], "announced": len(BODY)}, "ended after 1000 of|broke off"),
        ({"body": BODY[:1000]}, "ended after 1000 of"),
        ({"body": b"x" * len(BODY)}, "is not the pinned file"),
        ({"body": BODY + b"more"}, "a longer file found"),
        ({"body": b""}, "ended after 0 of"),
    ],
)
def test_bad_answer_is_one_sentence_and_leaves_nothing(tmp_path, answer, words):
    out = tmp_path / "out"
    with server(**answer) as (url, _), pytest.raises(InputError, match=words) as caught:
        fetching.fetch("tri", downloads=out, base_url=url, quiet=True)
    assert "\n" not in str(caught.value) and "'tri'" in str(caught.value)
    assert files_below(out) == []


def test_no_server_says_what_to_do(tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound, not listening: connections are refused
        url = f"http://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(fetching.Unreachable, match="cannot be reached.*--mirror"):
            fetching.fetch("tri", downloads=tmp_path / "out", base_url=url, quiet=True)
    assert not (tmp_path / "out").exists()


def test_silent_server_times_out(tmp_path, monkeypatch):
    monkeypatch.setattr(fetching, "TIMEOUT", 0.2)
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        url = f"http://127.0.0.1:{listening.getsockname()[1]}"
        with pytest.raises(InputError, match="broke off|cannot be reached"):
            fetching.fetch("tri", downloads=tmp_path, base_url=url, quiet=True)
    assert not (tmp_path / "some+where").exists()


def test_interrupted_copy_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(fetching, "_write", interrupt)
    with server() as (url, _), pytest.raises(KeyboardInterrupt):
        fetching.fetch("tri", downloads=tmp_path / "out", base_url=url, quiet=True)
    assert files_below(tmp_path / "out") == []


def mirror_with(folder: Path, data: bytes) -> Path:
    file = folder / "some+where" / "data" / "a b.obj"
    file.parent.mkdir(parents=True)
    file.write_bytes(data)
    return folder


def test_a_named_mirror_comes_before_that_of_the_environment(tmp_path, monkeypatch):
    named, variable = (mirror_with(tmp_path / name, BODY) for name in ("named", "variable"))
    monkeypatch.setenv(fetching.MIRROR_VARIABLE, str(variable))
    assert fetching.fetch("tri", downloads=tmp_path / "2", quiet=True).origin == str(variable)
    assert fetching.fetch("tri", mirror=named, downloads=tmp_path / "3", quiet=True).origin == str(named)
    assert fetching.mesh_path("tri", downloads=tmp_path / "4").read_bytes() == BODY


@pytest.mark.parametrize(
    "data, words",
    [(None, "has no readable"), (BODY[:-3], "ended after"), (BODY[::-1], "not the pinned file")],
)
def test_bad_mirror_file(tmp_path, data, words):
    folder = tmp_path / "mirror"
    folder.mkdir() if data is None else mirror_with(folder, data)
    with pytest.raises(InputError, match=words):
        fetching.mesh_path("tri", mirror=folder, downloads=tmp_path / "out")
    assert files_below(tmp_path / "out") == []


def test_mirror_that_is_no_folder_and_key_that_cannot_be_had(tmp_path):
    with pytest.raises(InputError, match="is no folder"):
        fetching.mesh_path("tri", mirror=tmp_path / "none", downloads=tmp_path)
    with pytest.raises(InputError, match="cannot be had: nowhere to be had"):
        fetching.mesh_path("gone", downloads=tmp_path)


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "out").write_text("a file where the folder should be")
    with pytest.raises(InputError, match="cannot write"):
        fetching.mesh_path("tri", mirror=mirror_with(tmp_path / "mirror", BODY), downloads=tmp_path / "out")


def test_table_is_complete_and_pinned():
    table = sources(TABLE)
    assert {
        "spot",
        "bob",
        "rocker-arm",
        "fandisk",
        "horse",
        "armadillo",
        "eight",
        "cheburashka",
        "eight-dense",
        "cow",
        "ogre",
        "teapot",
        "beast",
        "max-planck",
    } <= set(table)
    for entry in table.values():
        assert entry.role in ROLES and entry.key.replace("-", "").isalnum()
        if entry.obtainable:
            assert len(entry.commit) == 40 and len(entry.sha256) == 64 and entry.bytes > 0 and entry.licence
            assert bool(entry.member) == bool(entry.member_sha256) == entry.path.endswith(".zip")
    targets = [entry.relative_mesh_path for entry in table.values() if entry.obtainable]
    assert len(set(targets)) == len(targets)


@pytest.mark.parametrize(
    "text, words",
    [
        ("key,name\nspot,spot\n", "damaged"),
        (HEADER + "a,a,b/c,d,e,f,many,CC0,used,,,\n", "damaged"),
        (HEADER + "a,a,b/c,d,e,f,1,CC0,spare,,,\n", "unknown role"),
    ],
)
def test_damaged_table(tmp_path, text, words):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        sources(tmp_path / "bad.csv")


def test_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.undo()  # the real table from here on
    monkeypatch.setenv(fetching.MIRROR_VARIABLE, str(tmp_path))
    assert main(["fetch", "spott"]) == 2
    assert "no mesh is called 'spott'; known are spot" in capsys.readouterr().err
    assert main(["fetch", "spot", "cow", "--out", str(tmp_path / "out"), "--quiet"]) == 1
    error = capsys.readouterr().err
    assert "spot: the mirror" in error and "2 of 2 meshes could not be fetched" in error
    assert main(["fetch", "--list"]) == 0
    listed = capsys.readouterr().out
    assert all(key in listed for key in sources(TABLE)) and "  CC0-1.0" in listed
