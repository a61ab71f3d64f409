"""The transcribed tables agree with each other and with the identities the paper states."""

from __future__ import annotations

import math

import numpy as np
import pytest

from paper_artifact.catalogue import shapes_of
from paper_artifact.errors import InputError
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.published import PUBLISHED, published, tables

ROUNDING = 1e-4 + 1e-9  # half a last digit of the printed mean and of the printed seeds


def test_every_table_is_there_and_described():
    names = tables()
    assert names[:15] == ["1", "2", *[f"S{i}" for i in range(1, 14)]]
    readme = (PUBLISHED / "README.md").read_text()
    assert all(f"`{path.name}`" in readme for path in PUBLISHED.glob("*.csv"))
    for name in names:
        frame = published(name)
        assert len(frame) and (frame["source"] != "").all()
        if name not in ("S6", "S12"):
            assert {"shape", "dimension", "condition", "quantity", "value", "sd", "seeds", "note"} <= set(
                frame.columns
            )
            assert frame["value"].dtype == float and frame["sd"].dtype == float
            assert (
                not frame.drop(columns=["note", "value", "sd", "printed", "ratio"], errors="ignore")
                .duplicated()
                .any()
                or name == "floor"
            )


@pytest.mark.parametrize("shape", sorted(set(published("S7")["shape"])))
@pytest.mark.parametrize("condition", ["C0", "C1", "C2"])
def test_per_seed_values_have_the_printed_mean_and_sd(shape, condition):
    frame = published("S7")
    seeds = frame[(frame["shape"] == shape) & (frame["condition"] == condition)]["value"]
    mean, sd = frames.paper_arms().set_index(frames.ARM).loc[(shape, condition), ["value", "sd"]]
    assert len(seeds) == 3 and abs(seeds.mean() - mean) <= ROUNDING
    assert math.isnan(sd) or abs(seeds.std(ddof=1) - sd) <= ROUNDING


def test_bowls_per_seed_values_have_the_printed_mean_and_sd():
    frame = published("S10")
    for _, rows in frame.groupby(["shape", "condition"]):
        mean = rows[rows["seed"].isna()].iloc[0]
        seeds = rows[rows["seed"].notna()]["value"]
        assert len(seeds) == 3 and abs(seeds.mean() - mean["value"]) <= ROUNDING
        assert math.isnan(mean["sd"]) or abs(seeds.std(ddof=1) - mean["sd"]) <= ROUNDING


def test_group_means_follow_from_table_2():
    tails = frames.paper_arms("tail_bottleneck", "2").pivot(
        index="shape", columns="condition", values="value"
    )
    for row in frames.paper("ratio_C0_over_C1", "2").itertuples():
        members, mean, sd = tails.loc[list(shapes_of(row.shape))], row.value, row.sd
        ratios = members["C0"] / members["C1"]
        assert np.mean(ratios) == pytest.approx(mean, abs=0.02) and np.std(ratios, ddof=1) == pytest.approx(
            sd, abs=0.03
        )


def test_printed_factors_follow_from_the_values():
    arms = frames.paper_arms().set_index(frames.ARM)
    printed = arms[arms["ratio"] != ""]
    assert printed.groupby("table").size().to_dict() == {"1": 6, "2": 8, "S10": 2, "noise": 4}
    for (shape, _), row in printed.iterrows():
        ratio = arms.loc[(shape, "C0"), "value"] / row["value"]
        assert ratio == pytest.approx(float(row["ratio"]), abs=0.1 if ratio < 9 else 0.3)


def test_pins_are_half_lifetimes():
    frame = published("S11")
    for shape in ("eight", "armadillo", "horse"):
        rows = frame[
            (frame["shape"] == shape) & (frame["quantity"] == "lifetime") & (frame["samples"] == 20000)
        ]
        baseline = frames.paper_arms().set_index(frames.ARM).loc[(shape, "C0"), "value"]
        assert rows["value"].iloc[0] / 2 == pytest.approx(baseline, abs=ROUNDING)


def test_window_of_the_floor_multiplier_follows_from_the_margins():
    frame = published("S13").set_index("quantity")
    low = 6 * frame.loc["largest_out_over_floor", "value"].max()
    high = 6 * frame.loc["tightest_in_over_floor", "value"].min()
    assert low == pytest.approx(frame.loc["window_low", "value"], abs=0.04)
    assert high == pytest.approx(frame.loc["window_high", "value"], abs=0.04)


def test_unknown_names_are_refused():
    with pytest.raises(InputError, match="known: 1, 2, S1"):
        published("S14")
