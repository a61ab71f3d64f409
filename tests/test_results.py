"""The frames say what the records say: every tail, count and bar, the study of each run, what is missing."""

import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from paper_artifact import results
from paper_artifact.book.main_result import main_frame, main_runs
from paper_artifact.catalogue import study_config
from paper_artifact.errors import InputError
from paper_artifact.evaluate.scores import TAIL_DUMPS, tails
from paper_artifact.record.store import config_of, make_record, read_record, write_record
from paper_artifact.study.studies import STUDIES
from paper_artifact.verdict import verdicts


@pytest.fixture(scope="module")
def tables():
    return results.load()


def write_baseline(folder: Path, shape: str, seed: int) -> None:
    """Write the record of a finished C0 run."""
    config = study_config(shape, "C0", seed)
    ends = {"bottleneck": [0.01] * 3, "counts": [1, 0, 1], "chamfer": 0.005, "hausdorff95": 0.01}
    dump = ends | {"counts_at_target_floor": [1, 0, 1], "floor": 0.02, "triangles": 9, "chamfer_sum": 0.01}
    dumps = [dump | {"step": step, "bars": [[[0.0, 0.01]], [], []]} for step in config.dump_steps]
    mesh = {"name": shape, "sha256": "0" * 64, "diagonal": 3.4, "betti": None, "dimension": 2, "floor": 0.017}
    sections = {"mesh": mesh, "images": {"psnr": 30.0, "ssim": 0.95, "holdout_views": 6}}
    sections |= {"soup": {"triangles": 9, "resamplings": []}, "cpu_seconds": 60.0, "resumed_at": None}
    losses = {"step": list(range(1, 2501)), "loss": [1 / step for step in range(1, 2501)]}
    tails = ends | {"steps": [2300, 2400, 2500]}
    times = {"photometric": 30.0, "optimiser": 5.0, "evaluate": 9.0}
    write_record(make_record(config, dumps, tails, times, losses=losses, **sections), folder)


@pytest.mark.parametrize(
    ("shape", "condition"), [("sphere", "C1"), ("torus", "C6"), ("bob", "C0"), ("torus", "T1")]
)
def test_a_run_s_rows_are_its_record_s(tables, shape, condition):
    row = tables.runs.query("shape == @shape and condition == @condition").iloc[0]
    record = read_record(tables.folder / f"{row['run']}.json")
    tails, dimension = record["tails"], record["mesh"]["dimension"]
    last = [dump["bottleneck"][dimension] for dump in record["dumps"][-TAIL_DUMPS:]]
    assert row["tail"] == pytest.approx(tails["bottleneck"][dimension], rel=1e-6)
    assert row["tail"] == pytest.approx(np.mean(last), rel=1e-6)
    assert [row[f"count_h{d}"] for d in range(3)] == tails["counts"]
    assert row["psnr"] == record["images"]["psnr"]
    dumps = tables.dumps[(tables.dumps["run"] == row["run"]) & (tables.dumps["step"] > 0)]
    assert dumps["step"].tolist() == [dump["step"] for dump in record["dumps"]]
    bars = np.reshape(record["dumps"][-1]["bars"][2], (-1, 2))
    np.testing.assert_array_equal(dumps["bars_h2"].iloc[-1], bars)
    logged = [entry for entry in record.get("topology") or () if entry["event"] == "refresh"]
    own = tables.refreshes[tables.refreshes["run"] == row["run"]]
    assert own["step"].nunique() == len(logged)
    for entry in logged[:: max(len(logged) // 3, 1)]:
        for d, plan in entry["dimensions"].items():
            (found,) = own[(own["step"] == entry["step"]) & (own["dimension"] == int(d))].to_dict("records")
            assert (found["matched"], found["recruited"]) == (plan["matched"], plan["recruited"])
            pairs = [(bar["live"], bar["target"]) for bar in plan["targets"] if bar.get("live")]
            off = [abs(np.subtract(*pair)).max() for pair in pairs]
            assert found["residual"] == pytest.approx(max(off)) if off else np.isnan(found["residual"])


def test_every_committed_run_is_there_once_and_the_studies_name_theirs(tables):
    names = sorted(path.stem for path in tables.folder.glob("*.json"))
    assert tables.runs["run"].tolist() == names
    assert set(tables.studies["study"]) == set(STUDIES) and tables.studies["run"].notna().all()
    assert len(tables.of("table1")) == 115 and len(tables.of("table1", "table1")) == 115
    knobs = tables.of("knobs")
    assert set(knobs["setting"]) == {"rho=0.03", "rho=0.3", "ramp=(0.1, 0.4)", "ramp=(0.3, 0.6)"}
    assert set(knobs[knobs["setting"] == "rho=0.03"]["loss_rho"]) == {0.03}
    with pytest.raises(InputError, match="unknown study 'table9'"):
        tables.of("table9")


def test_expected_counts_are_the_bundle_s_for_every_arm_of_a_shape(tables):
    runs = tables.of("table1", "table2", "bowls")
    assert runs.groupby("shape", observed=True)["expected"].nunique().eq(1).all()
    expected = runs.groupby("shape", observed=True)["expected"].first()
    shapes = ["sphere", "torus", "double_torus", "eight", "bowl_wide", "two_spheres"]
    assert expected[shapes].tolist() == [1, 2, 2, 4, 1, 1]


def test_step_0_is_there_where_a_run_starts_as_the_study_does(tables):
    starts = results.measured("starts").set_index(["shape", "seed"])["bottleneck"]
    first = tables.dumps[tables.dumps["step"] == 0]
    same = first[(first["shape"] == "sphere") & (first["seed"] == 3)]
    assert set(same["bottleneck"]) == {starts["sphere", 3]} and {"C0", "B2", "B5"} <= set(same["condition"])
    assert "B1" not in set(first["condition"]), "its levers act on the first triangles"


def test_bars_that_are_no_pairs_are_a_sentence(tmp_path):
    write_baseline(tmp_path, "sphere", 0)
    (path,) = tmp_path.glob("*.json")
    record = read_record(path)
    for bars in ([[1.0, 2.0], [3.0]], [[1.0, 2.0, 3.0]]):
        dumps = [record["dumps"][0] | {"bars": [bars, [], []]}, *record["dumps"][1:]]
        kept = {name: record[name] for name in ("mesh", "images", "soup", "cpu_seconds", "losses")}
        write_record(make_record(config_of(record), dumps, record["tails"], {}, **kept), tmp_path)
        with pytest.raises(InputError, match=r"dumps\[0\] bars\[0\].* run it again"):
            results.load(folder=tmp_path)


def test_a_link_that_leads_nowhere_is_a_sentence(tmp_path):
    (tmp_path / "a.json").symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match="cannot read the record .*a.json: No such file"):
        results.load(folder=tmp_path)


def test_a_pickle_beside_records_of_others_is_not_opened(tmp_path, monkeypatch):
    write_baseline(tmp_path / "runs", "sphere", 0)
    monkeypatch.setattr(results, "RESULTS", tmp_path)
    results.load(folder=tmp_path / "runs")
    assert (tmp_path / ".frames" / "runs.pickle").is_file()
    monkeypatch.setattr(results, "RESULTS", tmp_path / "mine")
    monkeypatch.setattr("pickle.load", lambda file: pytest.fail("opened"))
    assert len(results.load(folder=tmp_path / "runs").runs) == 1


def test_what_is_missing_is_said_once_and_the_study_s_frames_are_kept(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "runs"
    monkeypatch.setattr(results, "RESULTS", tmp_path)
    for shape, seed in product(("sphere", "torus"), range(3)):
        write_baseline(folder, shape, seed)
    first = results.load(studies=["baseline"], folder=folder)
    said = capsys.readouterr().out
    assert said.startswith("baseline: 3 of 9 runs are not recorded: spot C0 seeds [0, 1, 2]; python -m")
    (kept,) = (tmp_path / ".frames").iterdir()
    again = results.load(studies=["baseline"], folder=folder)
    pd.testing.assert_frame_equal(first.runs, again.runs)
    kept.write_bytes(b"cut off")
    assert len(results.load(studies=["baseline"], folder=folder).runs) == 6
    write_baseline(folder, "spot", 0)
    assert len(results.load(studies=["baseline"], folder=folder).runs) == 7, "a new record is seen"
    shutil.rmtree(folder)
    folder.mkdir()
    assert results.load(studies=["baseline"], folder=folder).runs.empty
    with pytest.raises(InputError, match="profile 'fast'"):
        results.load("fast")


def test_full_trains_the_named_studies(tmp_path, monkeypatch):
    trained = []
    monkeypatch.setattr(results, "RETRAINED", tmp_path)
    monkeypatch.setattr("paper_artifact.pipeline.run", lambda config, mesh, results: trained.append(config))
    (tmp_path / "runs").mkdir()
    results.load("full", ["curvature"])
    assert trained == [study_config(shape, "C4", seed) for seed in range(3) for shape in ("sphere", "torus")]


def test_a_missing_measurement_names_its_script():
    with pytest.raises(InputError, match=r"data_scripts/measure/none\.py makes it"):
        results.measured("none")


@pytest.mark.parametrize("studies", (["tabel1"], "table1"))
def test_an_unknown_study_is_named(studies):
    with pytest.raises(InputError, match="no study is called"):
        results.load("recorded", studies)


def test_a_folder_without_records_has_the_columns(tables, tmp_path):
    none = results.load(folder=tmp_path / "missing")
    for name in ("dumps", "refreshes", "studies"):
        assert {*getattr(none, name)} == {*getattr(tables, name)}, name
    assert {each for each in tables.runs if not each.startswith("seconds_")} == {*none.runs}
    assert none.of("table1").empty and verdicts(none.of("table1")).empty and main_frame(main_runs(none)).empty


def test_records_without_truth_dumps_or_held_out_views_are_read_beside_the_study_s(tmp_path):
    write_baseline(tmp_path, "sphere", 0)
    common = {"losses": {"step": [1], "loss": [0.5]}, "cpu_seconds": 1.0, "resumed_at": None}
    common |= {"images": {"holdout_views": 0}, "soup": {"triangles": 9, "resamplings": []}}
    alone = {"step": 1, "counts": [1, 2, 0], "floor": 0.02, "bars": [[], [], []], "margins": [[], [], []]}
    for seed, dumps in ((1, []), (2, [alone])):  # with no dumps, and of photographs
        config = study_config("own", "C0", seed, steps=1, dump_steps=(1,) * len(dumps))
        ends = tails(dumps, len(dumps)) if dumps else {}
        write_record(make_record(config, dumps, ends, {}, **common), tmp_path)
    found = results.load(folder=tmp_path)
    own = found.runs[found.runs["shape"] == "own"].set_index("seed")
    lost = ["dimension", "tail", "tail_h2", "chamfer", "expected", "psnr", "diagonal", "betti_h0"]
    assert own[lost].isna().all(axis=None) and own["count_h1"].isna().tolist() == [True, False]
    assert found.dumps.query("shape == 'own'")["count_h1"].tolist() == [2]
    of = found.of("baseline")
    assert of["run"].tolist() == [path.stem for path in tmp_path.glob("sphere*")]
    assert of["dimension"].tolist() == [2] and of["dimension"].dtype == int


def test_outside_of_a_checkout_the_paper_s_tables_are_said_to_be_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(results, "PUBLISHED", tmp_path)
    results._published.cache_clear()
    with pytest.raises(InputError, match="holds no table of the paper; work in a checkout"):
        results.published("1")
