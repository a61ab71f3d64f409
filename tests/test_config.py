"""Configurations and catalogue: ranges, the paper's defaults, names that new fields and new defaults leave
alone."""

import json
from dataclasses import fields, make_dataclass, replace
from typing import get_type_hints

import numpy as np
import pytest

from paper_artifact import catalogue, config
from paper_artifact.catalogue import CONDITIONS, SHAPES, shape_row, study_config
from paper_artifact.config import (
    AllocationConfig,
    GivenConfig,
    LossConfig,
    RunConfig,
    config_from,
    config_values,
    identity,
    parse_changes,
    with_changes,
)
from paper_artifact.errors import InputError, require_memory
from paper_artifact.pipeline import run
from paper_artifact.record.store import config_hash


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"steps": 0}, "steps must be at least 1"),
        ({"steps": 2.5}, "steps takes a value of kind int, got 2.5"),
        ({"budget": 0}, "budget must be"),
        ({"budget": True}, "budget takes a value of kind int"),
        ({"seed": -1}, "seed must be at least 0"),
        ({"size": 21}, "at least 22 and at most 8192 pixels"),
        ({"vertex_lr": 0.0}, "vertex_lr must be positive and at most 1, got 0.0"),
        ({"opacity_lr": 1e38}, r"opacity_lr must be positive and at most 100, got 1e\+38"),
        ({"split_height": 1e-9}, "split_height must be at least 0.0001 and at most 10000, got 1e-09"),
        ({"final_lr": 2.0}, "final_lr must be positive and at most 1"),
        ({"vertex_lr": "fast"}, "vertex_lr takes a value of kind float, got 'fast'"),
        ({"views": 1}, "views must be at least 2"),
        ({"mlp_lr": float("nan")}, "mlp_lr must be positive and at most 100, got nan"),
        ({"vertex_lr": float("inf")}, "vertex_lr must be positive and at most 1, got inf"),
        ({"background": "grey"}, "unknown background 'grey'; choose one of white, black"),
        ({"dump_steps": (10, 2501)}, "dump_steps must"),
        ({"dump_steps": (1.5,)}, "dump_steps takes"),
        ({"topology": 3}, "unknown setting topology; choose among shape, condition"),
        ({"colour": 1}, "unknown setting colour"),
        ({"loss": {"rhoo": 0.2}}, "unknown setting rhoo; choose among kind, rho, ramp"),
        ({"loss": {"rho": -0.2}}, "rho must be positive"),
        ({"loss": {"rho": "x"}}, "rho takes a value of kind float"),
        ({"loss": {"ramp": (0.5, 0.2)}}, "ramp must be two fractions"),
        ({"loss": {"noise": -1e-3}}, "noise must be at least 0"),
        ({"loss": {"samples": 3}}, "samples must be at least 4"),
        ({"loss": {"dimensions": ()}}, "dimensions must be some of 0, 1, 2"),
        ({"loss": {"dimensions": (1, 3)}}, "dimensions must be some of 0, 1, 2"),
        ({"loss": {"dimensions": (1, 1)}}, "dimensions must be some of 0, 1, 2"),
        ({"loss": {"pull": 10**400}}, "pull takes a value of kind float"),
        ({"loss": {"ramp": (0, 10**400)}}, "ramp must be two fractions"),
        ({"loss": {"refresh_every": 0}}, "refresh_every must be at least 1"),
        ({"loss": {"fallback": "ignore"}}, "unknown fallback 'ignore'"),
        ({"loss": {"kind": "love"}}, "unknown kind 'love'"),
        ({"loss": {"recruitment": 1}}, "recruitment takes a value of kind bool"),
        ({"condition": "C0", "loss": {"rho": 1.0}}, "condition C0 has no loss, so it takes no loss settings"),
        ({"condition": "C9"}, "unknown condition 'C9'; choose one of C0, C1"),
        ({"loss": {"calibration_batches": 0}}, "calibration_batches must be at least 1"),
        ({"loss": {"samples": "auto"}}, "samples=auto belongs to the loss kind 'betti'"),
        ({"loss": {"betti": (1, 2, 1)}}, "belongs to the loss kind 'betti'"),
        ({"condition": "T1", "loss": {"guard": -0.1}}, "guard must be at least 0"),
        ({"condition": "T1", "loss": {"pull": -1.0}}, "pull must be at least 0"),
        ({"condition": "T1", "loss": {"suppress": "most"}}, "unknown suppress 'most'; choose one of floor"),
        ({"allocation": {"spread": 2.0}}, "condition C1 has no allocation"),
        ({"condition": "B2", "allocation": {"spread": 0.0}}, "spread must be at least 1e-06"),
        ({"condition": "B2", "allocation": {"subdivided": 1.5}}, "must be at least 0 and at most 1"),
        ({"condition": "B2", "allocation": {"protection": -1.0}}, "protection must be at least 0"),
        ({"condition": "B2", "allocation": {"centres": "none"}}, "unknown centres 'none'"),
    ],
)
def test_a_configuration_out_of_range_is_refused(changes, words):
    with pytest.raises(InputError, match=words):
        study_config("sphere", **({"condition": "C1"} | changes))


@pytest.mark.parametrize("value", ["100", [1], None, 20.5, True])
def test_a_value_of_another_kind_is_refused_by_name(value):
    with pytest.raises(InputError, match="steps takes a value of kind int, got"):
        RunConfig("sphere", steps=value)


@pytest.mark.parametrize(
    "make",
    [
        lambda: LossConfig(ramp=5),
        lambda: LossConfig(ramp=("a", "b")),
        lambda: LossConfig(ramp=(float("nan"), 1.0)),
        lambda: LossConfig(dimensions=[[1], [2]]),
        lambda: LossConfig(kind=np.zeros(3)),
        lambda: RunConfig("sphere", dump_steps=7.5),
        lambda: RunConfig("sphere", loss={"rho": 0.1}),
        lambda: RunConfig(3),
        lambda: GivenConfig(target=5),
    ],
)
def test_a_field_of_another_type_is_one_sentence(make):
    with pytest.raises(InputError, match=r"takes a value of kind|must be two fractions"):
        make()


def test_fields_are_stored_as_their_types():
    loss = LossConfig(rho=1, ramp=[0, np.float32(0.5)], dimensions=np.array([1, 2]), samples=np.int64(2048))
    assert loss == LossConfig(rho=1.0, ramp=(0.0, 0.5), dimensions=(1, 2))
    assert type(loss.rho) is float and type(loss.samples) is int and type(loss.ramp[1]) is float
    assert RunConfig("sphere", steps=np.int32(300), dump_steps=[300]).dump_steps == (300,)


@pytest.mark.parametrize("kind", [RunConfig, LossConfig, AllocationConfig, GivenConfig])
def test_every_number_has_a_largest_value(kind):
    for name, each in get_type_hints(kind).items():
        if each in (int, float):
            beyond = 10**400 if each is int else 1e308
            with pytest.raises(InputError, match=f"^{name} must be .*(at most|below) .*, got 1[0e]"):
                kind(**{"shape": "sphere"} if kind is RunConfig else {}, **{name: beyond})


def test_the_largest_values_ask_for_memory_before_anything_runs(tmp_path):
    most = {"views": 10_000, "size": 8192, "budget": 10**7, "initial_ratio": 10_000, "batch": 10_000}
    for changes, words in (
        (most, "10000 views of 8192 pixels a side"),
        ({"samples": 10**9}, "1000000000 samples"),
    ):
        with pytest.raises(InputError, match=f"{words} takes? at least .* GiB of memory"):
            run(study_config("sphere", **changes), results=tmp_path)
    with pytest.raises(InputError, match="takes at least .* GiB of memory"):
        require_memory(10**400, "it", "give less")


def test_defaults_are_the_papers():
    torus = study_config("torus")
    assert (torus.budget, torus.steps, torus.batch, torus.resample_every) == (700, 2500, 4, 100)
    assert torus.initial_ratio * torus.budget > 1000  # the whole effect hangs on it
    assert torus.dump_steps[-3:] == (2300, 2400, 2500)
    assert study_config("sphere", steps=250).dump_steps[-3:] == (230, 240, 250)
    assert study_config("sphere", steps=2).dump_steps == (1, 2)
    assert RunConfig("a.obj").budget == study_config("a.obj").budget == 1200
    assert study_config("eight", "C1").loss == LossConfig(samples=8192)
    assert study_config("torus", "C6").loss == LossConfig(recruitment=False, dimensions=(1,))
    guided = LossConfig("repulsion", repulsion_radius=2.0, samples=99)
    assert study_config("a.obj", "C2g", loss={"samples": 99}).loss == guided


def test_command_line_texts():
    parsed = parse_changes(["rho=1", "dimensions=1,2", "ramp=None", "floor-source=live"], "--loss")
    expected = LossConfig(rho=1.0, dimensions=(1, 2), ramp=None, floor_source="live")
    assert with_changes(LossConfig(), parsed) == expected
    assert with_changes(LossConfig(), {"dimensions": 1, "ramp": [0, 1]}).ramp == (0.0, 1.0)
    for text in ("rho", "=3"):
        with pytest.raises(InputError, match="--loss takes NAME=VALUE"):
            parse_changes([text], "--loss")


@pytest.mark.parametrize("condition", [each.name for each in CONDITIONS])
@pytest.mark.parametrize("shape", ["torus", "eight", "a.obj"])
def test_a_configuration_survives_json(shape, condition):
    words = {"betti": (1, 2, 1)} if condition.startswith("T") else None
    made = study_config(shape, condition, 3, loss=words, vertex_lr=0.5)
    assert config_from(json.loads(json.dumps(config_values(made)))) == made


# --- what names a run

# The defaults of version 1, as the first records have them. Whoever changes one raises DEFAULTS_VERSION and
# notes the old value in FORMER_DEFAULTS; a new field is added to neither.
VERSION_1 = {
    "condition": "C0", "seed": 0, "steps": 2500, "budget": 1200, "views": 48, "size": 200,
    "background": "white", "batch": 4, "vertex_lr": 0.01, "feature_lr": 0.05, "opacity_lr": 0.05,
    "mlp_lr": 0.01, "final_lr": 0.01, "initial_ratio": 7.5, "resample_every": 100,
    "split_views": 20, "split_height": 0.2, "samples": 20000, "loss": None,
    "dump_steps": (100, 200, 400, 700, 1000, 1300, 1600, 1900, 2100, 2300, 2400, 2500),
}  # fmt: skip
LOSS_VERSION_1 = {
    "kind": "topology", "rho": 0.1, "ramp": (0.2, 0.5), "recruitment": True, "noise": 0.0,
    "repulsion_radius": 4.0, "curvature_weighted": False, "samples": 2048, "dimensions": None,
    "bundle_seed": 0, "refresh_every": 10, "floor_source": "bundle", "fallback": "detach", "method": "fast",
}  # fmt: skip


def test_a_changed_default_raises_the_version_of_the_defaults():
    run, loss = config._former(1, ""), config._former(1, "loss.")
    now = {field.name: field.default for field in fields(RunConfig)} | run
    now_loss = {field.name: field.default for field in fields(LossConfig)} | loss
    assert {name: now[name] for name in VERSION_1} == VERSION_1
    assert {name: now_loss[name] for name in LOSS_VERSION_1} == LOSS_VERSION_1


def test_only_what_differs_from_the_defaults_names_a_run():
    plain = {"defaults": 1, "shape": "sphere", "condition": "C0", "seed": 0}
    assert identity(study_config("sphere")) == plain
    named = identity(study_config("torus", "C6", 2))
    assert named["budget"] == 700 and named["loss"] == {"recruitment": False, "dimensions": (1,)}
    assert config_hash(study_config("torus")) != config_hash(study_config("torus", budget=701))
    strong = study_config("cube", "C1", loss={"rho": 0.2})
    assert config_hash(study_config("cube", "C1")) != config_hash(strong)


def test_a_new_field_renames_no_run(monkeypatch):
    before = config_hash(study_config("torus", "C1"))
    wider_loss = make_dataclass("LossConfig", [("colour", str, "red")], bases=(LossConfig,), frozen=True)
    wider_run = make_dataclass("RunConfig", [("mood", int, 3)], bases=(RunConfig,), frozen=True)
    old = config_values(study_config("torus", "C1"))
    for module in (config, catalogue):
        monkeypatch.setattr(module, "LossConfig", wider_loss)
        monkeypatch.setattr(module, "RunConfig", wider_run)
    monkeypatch.setitem(config.PARTS, "loss", wider_loss)
    wide = config_from(old)
    assert (wide.mood, wide.loss.colour) == (3, "red") and config_hash(wide) == before
    assert config_hash(replace(wide, mood=4)) != before
    assert config_hash(replace(wide, loss=replace(wide.loss, colour="blue"))) != before


def test_a_changed_default_keeps_the_names_of_older_runs(monkeypatch):
    old = config_hash(study_config("sphere", "C1"))
    monkeypatch.setattr(config, "DEFAULTS_VERSION", 2)
    monkeypatch.setattr(config, "FORMER_DEFAULTS", {1: {"views": 24, "loss.rho": 0.3}})
    # Read as of version 1, absent fields mean the old values, and the same run has the name that it had.
    then = config_from({"shape": "sphere", "condition": "C1", "loss": {"dimensions": [2]}}, 1)
    assert (then.views, then.loss.rho) == (24, 0.3) and config_hash(then, 1) == old
    assert "views" not in identity(then, 1) and identity(then, 2)["views"] == 24
    with pytest.raises(InputError, match="version 3 is unknown"):
        config_from({"shape": "sphere"}, 3)
    with pytest.raises(InputError, match="shape is a name or a path, got None"):
        config_from({"shape": None})


# --- the catalogue


def test_the_catalogue_holds_together():
    for rows in (SHAPES, CONDITIONS):
        assert len({row.name for row in rows}) == len(rows), "a name is there twice"
    for row in SHAPES:
        assert {row.judged, *(row.dimensions or ())} <= {0, 1, 2}
        assert row.features[row.judged] > 0 and len(set(row.view)) > 1 and sum(row.up) == 1
        assert row.dimensions is None or row.judged in row.dimensions
    assert catalogue.shapes_of("loop group") == ("bob", "rocker-arm", "eight") and shape_row("a.obj") is None
