"""The committed soups of Table 2's gallery, and the counts that their runs are held against."""

from __future__ import annotations

import pytest

from paper_artifact import results
from paper_artifact.catalogue import PRIOR, shape_row, shapes_of, study_config
from paper_artifact.evaluate.diagram import significant_counts
from paper_artifact.evaluate.scores import evaluate_soup, make_target
from paper_artifact.evaluate.staircase import measure
from paper_artifact.record.store import read_record
from paper_artifact.scene.shapes import surface
from paper_artifact.soup.state import load_soup
from paper_artifact.study.studies import settings, study_configs

ARMS = ("C0", "C2", "C1")  # whose soups are committed


@pytest.fixture(scope="module")
def tables():
    return results.load(studies=["table2"])


def test_expected_counts_are_the_bundles(tables):
    """Of an external mesh the records expect what its clean surface shows at the density of the loss,
    measured again."""
    runs = tables.of("table2")
    for shape in ("bob", "rocker-arm", "spot"):
        row = shape_row(shape)
        counted = significant_counts(*measure(surface(shape), row.samples, row.bundle_seed))
        assert set(runs[runs["shape"] == shape]["expected"]) == {counted[row.judged]}


def test_the_gallerys_soups_are_committed(tables):
    runs = tables.of("table2").query("condition in @ARMS and seed == 0")
    assert len(runs) == len(shapes_of("loop group", "void group")) * len(ARMS)
    assert all(tables.soup_path(run).is_file() for run in runs["run"])


@pytest.mark.parametrize("run", [("bob", "C1"), ("fandisk", "C2"), ("horse", "C0")], ids="-".join)
def test_a_committed_soup_is_the_one_of_its_record(tables, run):
    """Measured again, the soup gives the record's last dump."""
    shape, condition = run
    (name,) = tables.of("table2").query("shape == @shape and condition == @condition and seed == 0")["run"]
    soup, last = load_soup(tables.soup_path(name)), read_record(tables.folder / f"{name}.json")["dumps"][-1]
    corners, target = soup.vertices.detach().numpy(), make_target(surface(shape), cache=None)
    again = evaluate_soup(corners, soup.corner_opacity(), target, seed=0, step=last["step"])
    assert again["counts"] == last["counts"]
    for quantity in ("bottleneck", "chamfer", "hausdorff95"):
        assert again[quantity] == pytest.approx(last[quantity], rel=1e-5)


def test_the_candidates_for_the_stronger_loss_are_one_at_a_time():
    usual = ("views", "size", "initial_ratio", "loss")
    for setting, configs in settings("strength").items():
        for config in configs:
            plain = study_config(config.shape, config.condition, config.seed)
            differing = [name for name in usual if getattr(config, name) != getattr(plain, name)]
            assert len(differing) == 1, setting


def test_the_search_of_the_levers_holds_the_frozen_pair():
    configs = study_configs("allocation_search")
    levers = {(config.allocation.protection, config.allocation.subdivided) for config in configs}
    assert {config.shape for config in configs} == {"sphere"} and len(levers) == 18
    assert (PRIOR.protection, PRIOR.subdivided) in levers
    assert (
        study_config("sphere", "B4", 1) in configs
    )  # what is frozen is a run of the allocation study itself
