"""Sets of photographs: fetched whole from a pinned commit, checked, told with the meshes."""

from __future__ import annotations

import hashlib

import pytest

from paper_artifact.cli import main
from paper_artifact.errors import InputError
from paper_artifact.scene import fetch as sets
from paper_artifact.scene.fetch import MIRROR_VARIABLE


def test_the_table_names_one_commit_and_a_licence_a_set():
    assert {name: len(each.files) for name, each in sets.photo_sets().items()} == {"castle": 11, "lego": 101}
    for each in sets.photo_sets().values():
        assert each.licence and len({(file.repository, file.commit) for file in each.files}) == 1
        assert all(len(file.commit) == 40 and len(file.sha256) == 64 for file in each.files)


def test_a_set_comes_whole_or_says_what_is_missing(tmp_path, monkeypatch, capsys):
    mirror, files = tmp_path / "mirror" / "some+where", {"views/a.png": b"first", "views/b.png": b"second"}
    rows = ["set,repository,commit,path,sha256,bytes,licence"]
    for path, data in files.items():
        (mirror / path).parent.mkdir(parents=True, exist_ok=True)
        (mirror / path).write_bytes(data)
        rows.append(f"two,some/where,abc,{path},{hashlib.sha256(data).hexdigest()},{len(data)},free")
    (tmp_path / "table.csv").write_text("\n".join(rows) + "\n")
    known = sets.photo_sets(tmp_path / "table.csv")
    for module in ("paper_artifact.scene.fetch", "paper_artifact.cli.scenes"):
        monkeypatch.setattr(f"{module}.photo_sets", lambda: known)
    monkeypatch.setenv(MIRROR_VARIABLE, str(mirror.parent))
    words = ["fetch", "two", "--out", str(tmp_path / "out"), "--quiet"]
    (mirror / "views/b.png").write_bytes(b"sec0nd")
    assert main(words) == 1 and "is not the pinned file of 'two/b.png'" in capsys.readouterr().err
    (mirror / "views/b.png").write_bytes(files["views/b.png"])
    assert main(words) == 0 and f"{tmp_path / 'out' / 'some+where' / 'views'}  (" in capsys.readouterr().out
    assert {p.name: p.read_bytes() for p in (tmp_path / "out/some+where/views").iterdir()} == {
        "a.png": b"first",
        "b.png": b"second",
    }
    assert main(words) == 0 and "already there" in capsys.readouterr().out
    assert main(["fetch", "--list"]) == 0 and "  free\n" in capsys.readouterr().out


def test_a_damaged_table_is_told(tmp_path):
    (tmp_path / "t.csv").write_text("set,repository,commit,path,sha256,bytes,licence\na,b/c,d,e,f,many,g\n")
    with pytest.raises(InputError, match="line 2 of"):
        sets.photo_sets(tmp_path / "t.csv")
    assert sets.photo_sets(tmp_path / "none.csv") == {}
