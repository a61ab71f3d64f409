"""Probes: the blindness ones' samples are uniform by area, the repair gate's are functions of name and seed.
What each metric says of the former, and that the loss alone repairs the latter: notebooks 02 and 05, whose
outputs are compared."""

import numpy as np
import pytest
from scipy.stats import kstest

from paper_artifact.errors import InputError
from paper_artifact.study import blindness as probes
from paper_artifact.study import repair


def test_revolution_is_uniform_by_area_on_a_spheroid():
    """On a prolate spheroid (half axes 1, 1, 2) the area below a height is known in closed form."""
    u, v = np.random.default_rng(0).random((2, 20_000))

    def polar_radius(angle):
        return 1 / np.sqrt(np.sin(angle) ** 2 + np.cos(angle) ** 2 / 4)

    z = probes.revolution(polar_radius, u, v)[:, 2] / 2

    def primitive(x):  # of sqrt(4 - 3 x²)
        return x * np.sqrt(4 - 3 * x**2) / 2 + 2 / np.sqrt(3) * np.arcsin(np.sqrt(3) * x / 2)

    def area_below(t):
        return (primitive(t) - primitive(-1)) / (primitive(1) - primitive(-1))

    assert kstest(z, area_below).pvalue > 1e-3


def test_sphere_of_revolution_is_the_sphere():
    u, v = np.random.default_rng(1).random((2, 500))
    close = probes.revolution(np.ones_like, u, v)
    np.testing.assert_allclose(close, probes.sphere_points(u, v), atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(close, axis=1), 1)


def test_handle_has_no_hidden_part_and_the_right_share():
    probe = probes.make_probe("thin handle", samples=6000)
    radius = np.linalg.norm(probe.b, axis=1)
    assert radius.min() > 1 - 1e-9
    ring = np.hypot(np.hypot(probe.b[:, 0], probe.b[:, 2] - 1) - probes.HANDLE_MAJOR, probe.b[:, 1])
    assert ring.min() > probes.HANDLE_TUBE - 1e-9
    share = 0.42  # the arc outside the sphere, 150 of 360 degrees
    visible = 4 * np.pi**2 * probes.HANDLE_MAJOR * probes.HANDLE_TUBE * share
    assert (radius > 1 + 1e-9).mean() == pytest.approx(visible / (visible + 4 * np.pi), rel=0.15)


@pytest.mark.parametrize("name, dimension", [("T1", 2), ("T2", 1), ("T3", 0), ("T4", 0)])
def test_probes_of_the_repair_gate_are_functions_of_their_names_and_seeds(name, dimension):
    probe, again, other = (repair.make_probe(name, seed) for seed in (0, 0, 1))
    assert probe.dimension == dimension and len(probe.start) == len(probe.target) == probe.bundle.samples
    assert np.array_equal(again.start, probe.start) and not np.array_equal(other.start, probe.start)


def test_unknown_probes():
    with pytest.raises(InputError, match="unknown blindness probe"):
        probes.make_probe("bump")
    with pytest.raises(InputError, match="unknown repair probe 'T9'"):
        repair.make_probe("T9")
