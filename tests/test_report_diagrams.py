"""Fig. S1's data: what is kept is what a dump of the same run measures, from the untrained soup on."""

from __future__ import annotations

import numpy as np
import pytest

from paper_artifact.evaluate.scores import make_target
from paper_artifact.pipeline import run
from paper_artifact.report import diagrams, measured
from paper_artifact.scene.shapes import make_shape
from tests.tiny_run import tiny_config


def test_the_kept_bars_are_those_of_the_run_s_dumps(tmp_path):
    config = tiny_config(condition="C1")
    target = make_target(make_shape("sphere"), config.samples, cache=None)
    kept = diagrams.run_diagrams(config, target, (0, 20, 60), tmp_path)
    assert sorted(kept["step"].unique()) == [0, 20, 60] and set(kept["condition"]) == {"C1"}
    for dump in run(config, results=tmp_path)["dumps"]:
        own = kept[kept["step"] == dump["step"]]
        if dump["step"] not in (20, 60):
            assert own.empty
            continue
        assert own["floor"].iloc[0] == pytest.approx(dump["floor"], rel=1e-6)
        longest = np.array([bar for bar in dump["bars"][2] if bar[1] - bar[0] > diagrams.SHORTEST])
        np.testing.assert_allclose(own[["birth", "death"]].to_numpy()[: len(longest)], longest, rtol=1e-6)


def test_the_stored_diagrams_tell_the_figure_s_story():
    stored = measured.read("diagrams")
    table = diagrams.diagram_table(stored)
    assert (stored["death"] - stored["birth"] > diagrams.SHORTEST * (1 - 1e-4)).all()
    assert table.index.tolist() == [
        (condition, step)
        for condition in diagrams.CONDITIONS
        for step in ("start", "step 200", "step 700", "step 1300", "step 2500")
    ]
    for step in ("start", "step 200"):  # no loss acts before the ramp
        assert len({tuple(table.loc[(condition, step)]) for condition in diagrams.CONDITIONS}) == 1
    assert table.loc[("C2", "step 2500"), "bars drawn"] > 10 * table.loc[("C0", "step 2500"), "bars drawn"]
    assert float(table.loc[("C1", "step 2500"), "death short by"]) < float(
        table.loc[("C0", "step 2500"), "death short by"]
    )
    figure = diagrams.diagram_figure(stored)
    assert len(figure.axes) == 15 and figure.axes[0].get_title() == "C0, start"
