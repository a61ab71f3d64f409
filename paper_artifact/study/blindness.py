"""Blindness probes (App. A, Table S1): a topologically right A and a wrong B, alike to Chamfer.

Three cases. In each, B has a defect of fixed size and A a benign deformation whose size is found by
bisection, so that both have the same Chamfer distance to the ground truth. The paper gives no parameters; the
defects here were matched to its printed values.

  thin handle (H1): unit sphere; B = with a ring (a torus, major radius .495, tube .055) through its pole;
                    A = with a Gaussian bump
  bridge (H0): two unit spheres 1.4 apart; B = with an open tube of radius .1137 between them; A = scaled
               about the centre
  puncture (H2): unit sphere; B = without the cap of opening angle .591; A = scaled about the centre

Chamfer here is the SUM of both directions' mean distances, divided by D, the ground truth's bounding-box
diagonal (Table 1 uses the mean). Samples are uniform by area on the surfaces themselves, 40,000 a cloud; all
three clouds are independent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from paper_artifact.alpha.distances import bottleneck
from paper_artifact.errors import InputError
from paper_artifact.evaluate.diagram import diagram_of
from paper_artifact.evaluate.geometry import chamfer_sum, point_distances
from paper_artifact.randomness import stream
from paper_artifact.topology.floor import measurement_floor, significant

SAMPLES = 40_000  # a cloud
# World units; the spheres' radius is 1.
HANDLE_MAJOR, HANDLE_TUBE = 0.495, 0.055  # thin handle: the ring's radii
BUMP_WIDTH = 0.3  # thin handle: standard deviation of A's bump
GAP, BRIDGE_RADIUS = 1.4, 0.1137  # bridge: between the spheres; the tube's radius
CAP_ANGLE = 0.591  # puncture: the cap's opening, radians from the axis
TOLERANCE = 1e-3  # of Chamfer, relative: what "equal" means
BISECTIONS = 60  # at most
TABLE_SIZE = 4001  # points of the tabulated area of a surface of revolution


@dataclass(frozen=True, eq=False)
class BlindnessProbe:
    """One case, matched: clouds (n,3) float64, world units."""

    name: str
    dimension: int  # the discriminating one
    truth: np.ndarray  # sample of the ground truth
    a: np.ndarray  # sample of the topologically right one
    b: np.ndarray  # sample of the wrong one
    diagonal: float  # of the ground truth's bounding box, world units
    parameter: float  # size of A's deformation that bisection found: bump height, or scale


@dataclass(frozen=True, eq=False)
class Reading:
    """What the metrics say about one cloud against the ground truth; all lengths divided by D."""

    chamfer_sum: float  # both directions' mean distances, added
    hausdorff95: float  # 95th percentile of the distances
    bars: np.ndarray  # (k,2) every bar in the discriminating dimension, radii
    floor: float  # the cloud's own
    target: np.ndarray  # (m,2) the ground truth's significant bars
    bottleneck: float  # of the significant bars to the target

    @property
    def significant(self) -> np.ndarray:
        """Return the bars above the floor (l,2)."""
        return self.bars[significant(self.bars, self.floor)]


def make_probe(name: str, seed: int = 0, samples: int = SAMPLES) -> BlindnessProbe:
    """Return the case `name` (one of CASES) with A bisected to B's Chamfer, a function of all arguments.

    Raises InputError for another name, or when no size of A's deformation gives B's Chamfer.
    """
    if name not in CASES:
        raise InputError(f"unknown blindness probe {name!r}; choose one of {', '.join(CASES)}")
    case = _CASES[name]
    draws, drawn_a, drawn_b = (
        stream(seed, f"probe-{name}-{which}").random((5, samples)) for which in ("truth", "a", "b")
    )
    truth, b = case.truth(draws), case.b(drawn_b)
    wanted = chamfer_sum(b, truth, case.diagonal)
    parameter = _bisect(
        lambda size: chamfer_sum(case.a(drawn_a, size), truth, case.diagonal) / wanted - 1, case.bounds, name
    )
    return BlindnessProbe(
        name, case.dimension, truth, case.a(drawn_a, parameter), b, case.diagonal, parameter
    )


def read(probe: BlindnessProbe) -> tuple[Reading, Reading]:
    """Return the readings of A and of B."""

    def bars_of(cloud: np.ndarray) -> tuple[np.ndarray, float]:
        return diagram_of(cloud, probe.diagonal)[probe.dimension], measurement_floor(cloud, probe.diagonal)

    truth, floor = bars_of(probe.truth)
    target = truth[significant(truth, floor)]
    readings = []
    for cloud in (probe.a, probe.b):
        bars, floor = bars_of(cloud)
        found = point_distances(cloud, probe.truth, probe.diagonal)
        distance = bottleneck(bars[significant(bars, floor)], target)
        readings.append(Reading(found["chamfer_sum"], found["hausdorff95"], bars, floor, target, distance))
    return readings[0], readings[1]


def noise_floor(probe: BlindnessProbe, seed: int = 0) -> float:
    """Return the Chamfer sum / D of a second sample of the ground truth: what a perfect surface reads."""
    again = _CASES[probe.name].truth(stream(seed, f"probe-{probe.name}-again").random((5, len(probe.truth))))
    return chamfer_sum(again, probe.truth, probe.diagonal)


def _bisect(excess: Callable[[float], float], bounds: tuple[float, float], name: str) -> float:
    """Return a parameter within `bounds` where |excess| <= TOLERANCE.

    The excess grows with the parameter, up to sampling noise. Raises InputError when the bounds hold no root.
    """
    low, high = bounds
    if excess(low) > TOLERANCE or excess(high) < -TOLERANCE:
        raise InputError(
            f"no deformation of A between {low} and {high} has B's Chamfer in the probe {name!r}; "
            "change its bounds"
        )
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        value = excess(middle)
        if abs(value) <= TOLERANCE:
            return middle
        low, high = (middle, high) if value < 0 else (low, middle)
    return (low + high) / 2


def revolution(
    radius: Callable[[np.ndarray], np.ndarray], u: np.ndarray, v: np.ndarray, start: float = 0.0
) -> np.ndarray:
    """Return points (n,3) uniform by area on r = radius(polar angle), polar angle in [start, π], axis z.

    u, v (n,): uniform in [0,1). The area element r sqrt(r² + r'²) sin is tabulated and inverted, so that the
    points move continuously with `radius`.
    """
    angle = np.linspace(start, np.pi, TABLE_SIZE)
    r = radius(angle)
    density = r * np.sqrt(r**2 + np.gradient(r, angle) ** 2) * np.sin(angle)
    cumulated = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    polar = np.interp(u * cumulated[-1], cumulated, angle)
    turn = 2 * np.pi * v
    unit = [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)]
    return radius(polar)[:, None] * np.column_stack(unit)


def sphere_points(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return points (n,3) uniform on the unit sphere; u, v (n,) uniform in [0,1)."""
    z, turn = 1 - 2 * u, 2 * np.pi * v
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])


def _sphere(draws: np.ndarray, scale: float = 1.0) -> np.ndarray:
    return scale * sphere_points(draws[0], draws[1])


def _handle_points(draws: np.ndarray) -> np.ndarray:
    """Return points (n,3) on the outside of sphere ∪ ring, uniform by area; draws (5,n) uniform in [0,1)."""
    ring_area = 4 * np.pi**2 * HANDLE_MAJOR * HANDLE_TUBE
    kept: list[np.ndarray] = []
    total = draws.shape[1]
    # Points inside the other surface are drawn again. A case is a function of its draws alone, so their fifth
    # row, which is for nothing else, names the generator of the further rounds: 53 random bits are its key.
    generator = np.random.Generator(np.random.Philox(key=int(draws[4, 0] * 2**53)))
    while sum(len(each) for each in kept) < total:
        d = generator.random((5, total)) if kept else draws
        sphere = sphere_points(d[0], d[1])
        turn, theta = 2 * np.pi * d[0], 2 * np.pi * d[1]
        radial = HANDLE_MAJOR + HANDLE_TUBE * np.cos(theta)
        ring = np.column_stack(
            [radial * np.cos(turn), HANDLE_TUBE * np.sin(theta), 1 + radial * np.sin(turn)]
        )
        on_ring = d[2] * (ring_area + 4 * np.pi) < ring_area
        points = np.where(on_ring[:, None], ring, sphere)
        by_area = d[3] * (HANDLE_MAJOR + HANDLE_TUBE) < radial  # the inside of a ring has less area
        around = np.hypot(points[:, 0], points[:, 2] - 1) - HANDLE_MAJOR
        hidden = np.where(
            on_ring, np.linalg.norm(points, axis=1) < 1, np.hypot(around, points[:, 1]) < HANDLE_TUBE
        )
        kept.append(points[~hidden & (by_area | ~on_ring)])
    return np.concatenate(kept)[:total]


def _bumped(draws: np.ndarray, height: float) -> np.ndarray:
    def radius(angle: np.ndarray) -> np.ndarray:
        return 1 + height * np.exp(-((2 * np.sin(angle / 2)) ** 2) / (2 * BUMP_WIDTH**2))

    return revolution(radius, draws[0], draws[1])


def _punctured(draws: np.ndarray) -> np.ndarray:
    return revolution(np.ones_like, draws[0], draws[1], start=CAP_ANGLE)


def _two_spheres(draws: np.ndarray, scale: float = 1.0) -> np.ndarray:
    shift = np.array([1 + GAP / 2, 0.0, 0.0])
    return scale * (_sphere(draws) + np.where(draws[2] < 0.5, 1, -1)[:, None] * shift)


def _bridged(draws: np.ndarray) -> np.ndarray:
    half = GAP / 2 + 1 - np.sqrt(1 - BRIDGE_RADIUS**2)  # the tube ends on the spheres
    tube_area = 2 * np.pi * BRIDGE_RADIUS * 2 * half
    turn = 2 * np.pi * draws[1]
    tube = np.column_stack(
        [half * (2 * draws[0] - 1), BRIDGE_RADIUS * np.cos(turn), BRIDGE_RADIUS * np.sin(turn)]
    )
    on_tube = draws[3] * (tube_area + 8 * np.pi) < tube_area
    return np.where(on_tube[:, None], tube, _two_spheres(draws))


@dataclass(frozen=True)
class _Case:
    """Samplers of draws (5,n), uniform in [0,1), and what the bisection needs."""

    truth: Callable[[np.ndarray], np.ndarray]
    a: Callable[[np.ndarray, float], np.ndarray]  # of the deformation's size, too
    b: Callable[[np.ndarray], np.ndarray]
    diagonal: float
    dimension: int
    bounds: tuple[float, float]  # of the deformation


_SPHERE, _BRIDGE = 2 * np.sqrt(3), float(np.linalg.norm([4 + GAP, 2, 2]))  # diagonals
_CASES = {
    "thin handle": _Case(_sphere, _bumped, _handle_points, _SPHERE, 1, (0.0, 0.6)),
    "bridge": _Case(_two_spheres, _two_spheres, _bridged, _BRIDGE, 0, (1.0, 1.1)),
    "puncture": _Case(_sphere, _sphere, _punctured, _SPHERE, 2, (1.0, 1.1)),
}
CASES = tuple(_CASES)
