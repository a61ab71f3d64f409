"""The transcribed tables agree with each other and with the identities the paper states."""

import math

import numpy as np
import pandas as pd
import pytest

from paper_artifact.catalogue import shapes_of
from paper_artifact.errors import InputError
from paper_artifact.results import PUBLISHED, published

ROUNDING = 1e-4 + 1e-9  # half a last digit of the printed mean and of the printed seeds


KEYS = ["shape", "condition"]


def means(*tables):
    """The paper's mean tails (all tables), one row per shape and condition, of the first table that has
    it."""
    frame = published(*(tables or ("1", "2", "S10", "noise", "ablations", "S7")), quantity="tail_bottleneck")
    return frame[frame["seed"].isna()].drop_duplicates(KEYS).set_index(KEYS)


def test_every_table_has_rows_sources_and_a_description():
    every = published()
    assert {"1", "2", *(f"S{number}" for number in range(1, 14))} <= set(every["table"])
    assert (every["source"] != "").all() and every["value"].dtype == float and every["sd"].dtype == float
    readme = (PUBLISHED / "README.md").read_text()
    assert all(f"`{path.name}`" in readme for path in PUBLISHED.glob("*.csv"))
    keys = every.drop(columns=["note", "value", "sd", "printed", "ratio"])
    assert set(every[keys.duplicated()]["table"]) <= {"floor", "S12", "S6"}
    texts = published("S6")
    assert texts["value"].isna().all() and (texts["printed"] != "").any() and "NeRF" in set(texts["shape"])


@pytest.mark.parametrize("table", ["S7", "S10"])
def test_per_seed_values_have_the_printed_mean_and_sd(table):
    frame = published(table, quantity="tail_bottleneck").dropna(subset="seed")
    for arm, rows in frame.groupby(KEYS):
        mean, sd = means().loc[arm, ["value", "sd"]]
        assert len(rows) == 3 and abs(rows["value"].mean() - mean) <= ROUNDING, arm
        assert math.isnan(sd) or abs(rows["value"].std(ddof=1) - sd) <= ROUNDING, arm


def test_group_means_follow_from_table_2():
    tails = means("2")["value"].unstack("condition")
    for row in published("2", quantity="ratio_C0_over_C1").itertuples():
        members, mean, sd = tails.loc[list(shapes_of(row.shape))], row.value, row.sd
        ratios = members["C0"] / members["C1"]
        assert np.mean(ratios) == pytest.approx(mean, abs=0.02)
        assert np.std(ratios, ddof=1) == pytest.approx(sd, abs=0.03)


def test_printed_factors_follow_from_the_values():
    arms = means()
    printed = arms[arms["ratio"].notna()]
    assert printed.groupby("table").size().to_dict() == {"1": 6, "2": 8, "S10": 2, "noise": 4}
    for (shape, _), row in printed.iterrows():
        ratio = arms.loc[(shape, "C0"), "value"] / row["value"]
        assert ratio == pytest.approx(float(row["ratio"]), abs=0.1 if ratio < 9 else 0.3)


def test_pins_are_half_lifetimes():
    frame = published("S11")
    for shape in ("eight", "armadillo", "horse"):
        rows = frame.query("shape == @shape and quantity == 'lifetime' and samples == 20000")
        baseline = means().loc[(shape, "C0"), "value"]
        assert rows["value"].iloc[0] / 2 == pytest.approx(baseline, abs=ROUNDING)


def test_window_of_the_floor_multiplier_follows_from_the_margins():
    frame = published("S13").set_index("quantity")
    low = 6 * frame.loc["largest_out_over_floor", "value"].max()
    high = 6 * frame.loc["tightest_in_over_floor", "value"].min()
    assert low == pytest.approx(frame.loc["window_low", "value"], abs=0.04)
    assert high == pytest.approx(frame.loc["window_high", "value"], abs=0.04)


def test_unknown_names_are_refused():
    with pytest.raises(InputError, match="no table 'S14' here; known: 1, 2"):
        published("S14")


def test_table_s6_has_a_source_for_every_method_but_the_paper_s_own():
    methods = set(published("S6")["shape"])
    found = pd.read_csv(PUBLISHED / "literature.csv", dtype=str, keep_default_na=False)
    assert methods - set(found["method"]) == {"DiffSoup + prior (§ A)", "this work"}
    assert found["key"].is_unique and set(found["checked"]) == {"abstract", "objective"}
    assert found["year"].str.fullmatch(r"20\d\d").all() and (found != "").all().all()
    assert found["link"].str.fullmatch(r"https://arxiv\.org/abs/\d{4}\.\d{5}").all()
