"""The book: every link and picture is there, all 28 items stand in it with the verdict that their statements
come to, and the README's picture is what today's records give."""

from __future__ import annotations

import importlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import nbformat
import pandas as pd
import pytest
from PIL import Image

from paper_artifact.book import api, front, views
from paper_artifact.book.build import OWN, build
from paper_artifact.book.contents import chapters, figures, write_figures
from paper_artifact.book.htmltable import column, csv_text, find_table, table_rows
from paper_artifact.book.items import PAIRS, listed
from paper_artifact.book.pages import MENU, ticks
from paper_artifact.book.pairs import Pair, one_of, side, sides, tally, within_text, word
from paper_artifact.book.sources import Sources
from paper_artifact.catalogue import shapes_of
from paper_artifact.files import REPOSITORY
from paper_artifact.notebooks import NOTEBOOKS
from paper_artifact.report.kit.records import collect
from paper_artifact.scene.shapes import make_shape
from tests.report_records import write_study


class Page(HTMLParser):
    """A page's links, what it loads, the names in it, and its pictures without words."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links, self.loads, self.names, self.wordless = [], [], set(), []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.names |= {given["id"]} if given.get("id") else set()
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        self.loads += [
            given[name] for name in ("src", "href") if given.get(name) and tag in ("img", "link", "script")
        ]
        if tag == "img" and not given.get("alt"):
            self.wordless.append(given.get("src"))


@pytest.fixture(scope="module")
def sources():
    return Sources.read(executed=Path("/nowhere"))


@pytest.fixture(scope="module")
def book(sources, tmp_path_factory):
    """The book of the committed records; a small mesh stands for every ground truth, which takes long."""
    folder = tmp_path_factory.mktemp("book")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(views, "surface", lambda shape: make_shape("cube"))
        found = build(folder, sources)
    return folder, found


def pages(folder):
    return {path: Page(path) for path in sorted(folder.rglob("*.html"))}


def test_every_link_leads_somewhere_and_nothing_comes_from_the_network(book):
    folder, _ = book
    read = pages(folder)
    assert {folder / file for _, file in MENU} <= read.keys()
    for path, page in read.items():
        for link in page.links + page.loads:
            if link == "data:,":
                continue
            assert not re.match(r"[a-z]+:", link), f"{path.name} leads out: {link}"
            file, _, name = link.partition("#")
            target = (path.parent / unquote(file)).resolve() if file else path
            assert target.is_file() and target.is_relative_to(folder.resolve()), f"{path.name}: {link}"
            if name:
                assert unquote(name) in read[target].names, f"{path.name}: {link}"
        assert not page.wordless, f"{path.name}: pictures without alternative text"
        assert not re.search(r"@import|url\(|https?://[^\s<]*\.(js|css|woff)", path.read_text())


def test_every_notebook_and_every_picture_of_it_is_there(book, sources):
    folder, _ = book
    assert {path.stem for path in (folder / "notebooks").iterdir()} == {
        path.stem for path in NOTEBOOKS.glob("*.ipynb")
    }
    shown = {figure.name for chapter in sources.chapters.values() for figure in figures(chapter)}
    assert {path.stem for path in (folder / "figures").iterdir()} == shown | {"main_result"}
    for path in (folder / "figures").glob("*.png"):
        with Image.open(path) as picture:
            picture.verify()
    tables = {path.name for path in (folder / "tables").iterdir()}
    assert set(OWN) <= tables
    assert len(tables) == len(OWN) + sum(len(chapter.tables) for chapter in sources.chapters.values())
    for path in (folder / "tables").iterdir():
        assert len(pd.read_csv(path, header=None, dtype=str, keep_default_na=False)), path.name


def test_all_28_items_are_there_with_the_verdict_of_their_statements(book):
    folder, found = book
    names = [each.listed.item for each in found]
    assert names == ["Table 1", "Table 2", *(f"Table S{n}" for n in range(1, 14))] + [
        "Fig. 1",
        *(f"Fig. S{n}" for n in range(1, 13)),
    ]
    assert set(names) == set(PAIRS)
    front_page = (folder / "index.html").read_text()
    table = pd.read_csv(folder / "tables" / "items.csv", keep_default_na=False).set_index("item")
    pairs = pd.read_csv(folder / "tables" / "pairs.csv", keep_default_na=False)
    for each in found:
        assert each.pairs and each.listed.compared and each.listed.title
        assert f'href="items.html#{each.key}"' in front_page
        assert table.loc[each.listed.item, "verdict"] == word(each.pairs)
        said = pairs[pairs["item"] == each.listed.item]["holds"]
        assert len(said) == len(each.pairs)
        outcome = {(True, False): "agrees", (True, True): "partly", (False, True): "differs"}
        expected = outcome.get(((said == "yes").any(), (said == "no").any()), "not recorded")
        assert each.word.split(",")[0] == expected
        for name in each.listed.notebooks:
            assert (NOTEBOOKS / f"{name}.ipynb").is_file()


def test_the_readmes_table_has_every_item_at_its_notebook():
    rows = re.findall(r"^\| (.*?) \| `(\d\d_\w+)` \|", (REPOSITORY / "README.md").read_text(), re.MULTILINE)
    text = dict(map(reversed, rows))
    for each in listed():
        number = each.item.split()[-1]
        assert re.search(rf"\b{number}\b", text[each.notebooks[0]]), f"{each.item}: {each.notebooks[0]}"


def test_eight_soups_and_more_stand_beside_their_ground_truth(book):
    folder, _ = book
    found = sorted(path.stem for path in (folder / "soups").glob("*.html"))
    assert len(found) >= 8 and set(shapes_of("loop group", "void group")) <= set(found)
    for name in found:
        text = (folder / "soups" / f"{name}.html").read_text()
        data = json.loads(re.search(r'type="application/json">(.*?)</script>', text, re.S)[1])
        assert [part["name"].split(",")[0] for part in data["parts"]] == ["ground truth", "C0", "C1", "C2"]


def test_a_ground_truth_that_cannot_be_had_is_said(sources, tmp_path, monkeypatch):
    def fail(shape):
        raise views.InputError("no mesh")

    monkeypatch.setattr(views, "surface", fail)
    monkeypatch.setattr(views, "main_runs", lambda sources: collect([("bob", arm, 0) for arm in front.ARMS]))
    (view,) = views.write_views(sources, tmp_path)
    assert "ground truth is not shown: no mesh" in view.note and len(view.arms) == 3


def test_the_readmes_picture_is_of_the_committed_records(sources):
    text = front.PICTURE.read_text(encoding="utf-8")
    assert len(text) <= 150_000 and "(results/main_result.svg)" in (REPOSITORY / "README.md").read_text()
    shown = front.numbers(sources)
    assert front.picture_numbers(text) == shown, "python -m paper_artifact book --refresh makes it again"
    assert all(len(arm["tails"]) >= 3 for row in shown.values() for arm in row["arms"].values())
    assert front.picture_numbers("<svg></svg>") is None


def test_without_a_record_the_result_says_so(sources, tmp_path):
    empty = Sources(sources.chapters, tmp_path)
    table = front.main_table(empty)
    assert (table[["C0", "C1", "C2", "verdict"]] == "not recorded").all(axis=None)
    assert "on 0 of 0 shapes" in front.main_sentence(empty)
    assert front.picture_numbers(front.picture_svg(empty)) == front.numbers(empty)
    assert [word(PAIRS[item](empty)) for item in ("Table 1", "Table S2", "Table S8")] == ["not recorded"] * 3


def test_words_and_tallies():
    yes, no, none = (
        Pair("a", "1", "1", True),
        Pair("b", "2", "1", False),
        Pair("c", "not recorded", "1", None),
    )
    lost = Pair("d", "could not be had", "1", None)
    assert [word(each) for each in ([yes, yes], [yes, no], [no], [none], [yes, none], [yes, lost], [])] == [
        "agrees",
        "partly",
        "differs",
        "not recorded",
        "agrees, so far",
        "agrees",
        "not recorded",
    ]
    assert tally([yes, no, none, lost]) == "1 of 2, 1 not recorded, 1 could not be had"


def test_sides_of_two_arms(tmp_path):
    assert [
        side(0.02, 0.001, 0.03, 0.002),
        side(0.03, 0.01, 0.02, 0.001),
        side(0.5, float("nan"), 0.4, 0.1),
    ] == [-1, 0, 0]
    assert side(0.0249, 0.0, 0.0248, 0.0) == 0, "the last printed digit"
    tails = {"C0": 0.06, "C1": 0.01, "C2": 0.05}
    runs = {("cube", arm, seed): tail + seed / 1e4 for arm, tail in tails.items() for seed in range(3)}
    write_study(tmp_path / "runs", runs)
    collected = collect(runs, folder=tmp_path / "runs")
    first, second = sides(collected, ("1",), (("C1", "C0"), ("C2", "C0")))
    assert (first.holds, second.holds) == (True, False), "the paper's control is above the baseline"
    assert ".0101±.0001 below .0601±.0001" in first.ours and ".1346 above .0582" in second.paper


def test_texts_against_ranges_and_counts():
    assert within_text("w", "1.20–1.25", "1.23").holds and not within_text("w", "1.20–1.25", "1.26").holds
    assert within_text("w", "2.57–2.64", "2.6").holds
    assert one_of("o", "(1,2,1) 4×, (1,2,0) 1×", "(1,2,0)").holds
    assert not one_of("o", "0 / 1", "1 / 1").holds


def test_tables_of_html_keep_their_spans():
    html = (
        "<p>x</p><table><tr><th></th><th colspan='2'>a</th></tr><tr><th rowspan=2>r</th><td>1</td>"
        "<td>2, 3</td></tr><tr><td>4 <b>x</b></td><td></td></tr></table><table></table>"
    )
    (rows,) = table_rows(html)
    assert rows == [["", "a", "a"], ["r", "1", "2, 3"], ["r", "4 x", ""]]
    assert csv_text(rows).splitlines()[1] == 'r,1,"2, 3"'
    assert find_table([rows], "4 x") is rows and find_table([rows], "5") is None
    assert column([["", "n"], ["k", "5"]], "n") == {"k": "5"} and column(rows, "z") == {}


def notebook(
    path: Path, *, source: str = "show('x')", output: str = "committed", error: bool = False
) -> None:
    made = nbformat.v4.new_notebook()
    cell = nbformat.v4.new_code_cell(source, execution_count=1)
    cell.outputs = [nbformat.v4.new_output("display_data", {"image/png": "aGFsbG8=", "text/plain": output})]
    if error:
        cell.outputs.append(nbformat.v4.new_output("error", ename="E", evalue="", traceback=[]))
    made.cells = [nbformat.v4.new_markdown_cell("# A title (Table 1)"), cell]
    path.parent.mkdir(exist_ok=True)
    nbformat.write(made, path)


def test_executed_copies_are_taken_only_where_they_are_of_this_code(tmp_path):
    for name, changes in (
        ("01_same", {}),
        ("02_other", {"source": "show('y')"}),
        ("03_failed", {"error": True}),
    ):
        notebook(tmp_path / "notebooks" / f"{name}.ipynb")
        notebook(tmp_path / "executed" / f"{name}.ipynb", output="executed", **changes)
    notebook(tmp_path / "notebooks" / "04_alone.ipynb")
    found = chapters(tmp_path / "notebooks", tmp_path / "executed")
    assert [each.executed for each in found] == [True, False, False, False]
    texts = [each.notebook.cells[1].outputs[0]["data"]["text/plain"] for each in found]
    assert texts == ["executed", "committed", "committed", "committed"]
    assert {each.title for each in found} == {"A title"}
    assert [each.state[:8] for each in found] == ["executed", *["with its"] * 3]
    found[3].notebook.cells[1].outputs = []
    assert found[3].state.startswith("not executed yet")


def test_svg_pictures_of_run_all_come_before_those_in_the_notebooks(tmp_path):
    notebook(tmp_path / "notebooks" / "01_one.ipynb", source='x = 1\nshow("key", figure)')
    (chapter,) = chapters(tmp_path / "notebooks", tmp_path)
    assert write_figures(chapter, tmp_path / "f") == {(1, 0): "01_one_key.png"}
    assert (tmp_path / "f" / "01_one_key.png").read_bytes() == b"hallo"
    (tmp_path / "f" / "01_one_key.svg").write_text("<svg/>")
    assert write_figures(chapter, tmp_path / "f") == {(1, 0): "01_one_key.svg"}
    assert not (tmp_path / "f" / "01_one_key.png").exists()


def test_the_reference_has_every_public_name_with_its_words(book):
    text = (book[0] / "api.html").read_text()
    for name in api.PACKAGES:
        package = importlib.import_module(name)
        public = {each for each in vars(package) if not each.startswith("_")}
        shown = {entry.name for each in api.packages((name,)) for entry in each.entries}
        assert shown == {each for each in public if callable(getattr(package, each))} and len(shown) >= 5
    for entry in (entry for package in api.packages() for entry in package.entries):
        assert f'id="{entry.name}"' in text and entry.text, entry.name
        assert all(comment for _, comment in entry.fields if entry.name == "Bundle"), entry.fields
    assert "alpha_persistence(points: ndarray, method: str = &#39;fast&#39;" in text
    assert str(ticks("a `b<` c")) == "a <code>b&lt;</code> c"
    assert api.blocks("one\ntwo\n\n    code  here\n") == [("text", "one two"), ("code", "code  here")]
