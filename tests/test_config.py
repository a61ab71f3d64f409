"""The run configuration: ranges, the paper's defaults."""

from __future__ import annotations

import pytest

from paper_artifact.errors import InputError
from paper_artifact.train.config import RunConfig, default_config


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"steps": 0}, "steps must be at least 1"),
        ({"steps": -5}, "steps must be at least 1"),
        ({"budget": 0}, "budget must be"),
        ({"seed": -1}, "seed must not be negative"),
        ({"size": 21}, "at least 22 pixels"),
        ({"vertex_lr": 0.0}, "vertex_lr must be positive"),
        ({"views": 1}, "views must be at least 2"),
        ({"mlp_lr": float("nan")}, "mlp_lr must be positive"),
        ({"vertex_lr": float("inf")}, "finite"),
        ({"background": "grey"}, "white or black"),
        ({"dump_steps": (10, 2501)}, "dump_steps must"),
        ({"dump_steps": 5}, "dump_steps must"),
        ({"topology": 3}, "topology must"),
        ({"colour": 1}, "unknown configuration colour"),
    ],
)
def test_a_configuration_out_of_range_is_refused(changes, words):
    with pytest.raises(InputError, match=words):
        default_config("sphere", **changes)


def test_defaults_are_the_papers():
    config = default_config("torus")
    assert (config.budget, config.steps, config.batch, config.resample_every) == (700, 2500, 4, 100)
    assert (
        config.initial_ratio * config.budget > 1000
    )  # thousands of initial points: the whole effect hangs on it (trainer.md)
    assert config.dump_steps[-3:] == (2300, 2400, 2500)
    assert default_config("sphere", steps=250).dump_steps[-3:] == (230, 240, 250)
    assert default_config("sphere", steps=2).dump_steps == (1, 2)
    assert RunConfig("a.obj").budget == default_config("a.obj").budget == 1200
