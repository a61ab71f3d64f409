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

    name: str  # one of CASES
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


CASES = ("thin handle", "bridge", "puncture")


def make_probe(name: str, seed: int = 0, samples: int = SAMPLES) -> BlindnessProbe:
    """Return the case `name` (one of CASES) with A bisected to B's Chamfer, a function of all arguments.

    Raises InputError for another name, or when no size of A's deformation gives B's Chamfer.
    """
    if name not in CASES:
        raise InputError(f"unknown blindness probe {name!r}; choose one of {', '.join(CASES)}")
    draws = {
        which: stream(seed, f"probe-{name}-{which}").random((5, samples)) for which in ("truth", "a", "b")
    }
    truth_of, a_of, b_of, diagonal, dimension, low, high = _CASES[name]()
    truth, b = truth_of(draws["truth"]), b_of(draws["b"])
    wanted = chamfer_sum(b, truth, diagonal)
    parameter = _bisect(
        lambda size: chamfer_sum(a_of(draws["a"], size), truth, diagonal) - wanted,
        low,
        high,
        TOLERANCE * wanted,
        name,
    )
    return BlindnessProbe(
        name=name,
        dimension=dimension,
        truth=truth,
        a=a_of(draws["a"], parameter),
        b=b,
        diagonal=diagonal,
        parameter=parameter,
    )


def read(probe: BlindnessProbe, method: str = "fast") -> tuple[Reading, Reading]:
    """Return the readings of A and of B."""
    truth, floor = _bars(probe.truth, probe, method)
    target = truth[significant(truth, floor)]
    readings = []
    for cloud in (probe.a, probe.b):
        bars, floor = _bars(cloud, probe, method)
        distances = point_distances(cloud, probe.truth, probe.diagonal)
        distance = bottleneck(bars[significant(bars, floor)], target)
        readings.append(
            Reading(
                chamfer_sum=distances["chamfer_sum"],
                hausdorff95=distances["hausdorff95"],
                bars=bars,
                floor=floor,
                target=target,
                bottleneck=distance,
            )
        )
    return readings[0], readings[1]


def noise_floor(probe: BlindnessProbe, seed: int = 0) -> float:
    """Return the Chamfer sum / D of a second sample of the ground truth: what a perfect surface reads."""
    truth_of = _CASES[probe.name]()[0]
    again = truth_of(stream(seed, f"probe-{probe.name}-again").random((5, len(probe.truth))))
    return chamfer_sum(again, probe.truth, probe.diagonal)


def _bars(cloud: np.ndarray, probe: BlindnessProbe, method: str) -> tuple[np.ndarray, float]:
    bars = diagram_of(cloud, probe.diagonal, method)[probe.dimension]
    return bars, measurement_floor(cloud, probe.diagonal)


def _bisect(excess: Callable[[float], float], low: float, high: float, tolerance: float, name: str) -> float:
    """Return a parameter in [low, high] where |excess| <= tolerance.

    The excess grows with the parameter, up to sampling noise. Raises InputError when the bounds hold no root.
    """
    if excess(low) > tolerance or excess(high) < -tolerance:
        raise InputError(
            f"no deformation of A between {low} and {high} has B's Chamfer in the probe {name!r}; "
            "change its bounds"
        )
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        value = excess(middle)
        if abs(value) <= tolerance:
            return middle
        low, high = (middle, high) if value < 0 else (low, middle)
    return (low + high) / 2


def revolution(
    radius: Callable[[np.ndarray], np.ndarray],
    u: np.ndarray,
    v: np.ndarray,
    start: float = 0.0,
    end: float = np.pi,
) -> np.ndarray:
    """Return points (n,3) uniform by area on r = radius(polar angle), polar angle in [start, end], axis z.

    u, v (n,): uniform in [0,1). The area element r sqrt(r² + r'²) sin is tabulated and inverted, so that the
    points move continuously with `radius`.
    """
    angle = np.linspace(start, end, TABLE_SIZE)
    r = radius(angle)
    density = r * np.sqrt(r**2 + np.gradient(r, angle) ** 2) * np.sin(angle)
    cumulated = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    polar = np.interp(u * cumulated[-1], cumulated, angle)
    distance, turn = radius(polar), 2 * np.pi * v
    return np.column_stack(
        [
            distance * np.sin(polar) * np.cos(turn),
            distance * np.sin(polar) * np.sin(turn),
            distance * np.cos(polar),
        ]
    )


def sphere_points(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return points (n,3) uniform on the unit sphere; u, v (n,) uniform in [0,1)."""
    z, turn = 1 - 2 * u, 2 * np.pi * v
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])


def _handle_points(draws: np.ndarray) -> np.ndarray:
    """Return points (n,3) on the outside of sphere ∪ ring, uniform by area; draws (5,n) uniform in [0,1)."""
    ring_area = 4 * np.pi**2 * HANDLE_MAJOR * HANDLE_TUBE
    kept, rounds = [], 0
    total = draws.shape[1]
    # Points inside the other surface are drawn again. A case is a function of its draws alone, so their fifth
    # row, which is for nothing else, names the generator of the further rounds: 53 random bits are its key.
    generator = np.random.Generator(np.random.Philox(key=int(draws[4, 0] * 2**53)))
    while sum(map(len, kept)) < total:
        d = draws if rounds == 0 else generator.random((5, total))
        rounds += 1
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


def _thin_handle():
    def bump(draws, height):
        return revolution(
            lambda angle: 1 + height * np.exp(-((2 * np.sin(angle / 2)) ** 2) / (2 * BUMP_WIDTH**2)),
            draws[0],
            draws[1],
        )

    return lambda draws: sphere_points(draws[0], draws[1]), bump, _handle_points, 2 * np.sqrt(3), 1, 0.0, 0.6


def _bridge():
    shift = np.array([1 + GAP / 2, 0.0, 0.0])

    def spheres(draws, scale=1.0):
        return scale * (sphere_points(draws[0], draws[1]) + np.where(draws[2] < 0.5, 1, -1)[:, None] * shift)

    def bridged(draws):
        half = GAP / 2 + 1 - np.sqrt(1 - BRIDGE_RADIUS**2)  # the tube ends on the spheres
        tube_area = 2 * np.pi * BRIDGE_RADIUS * 2 * half
        turn = 2 * np.pi * draws[1]
        tube = np.column_stack(
            [half * (2 * draws[0] - 1), BRIDGE_RADIUS * np.cos(turn), BRIDGE_RADIUS * np.sin(turn)]
        )
        on_tube = draws[3] * (tube_area + 8 * np.pi) < tube_area
        return np.where(on_tube[:, None], tube, spheres(draws))

    diagonal = float(np.linalg.norm([4 + GAP, 2, 2]))
    return spheres, spheres, bridged, diagonal, 0, 1.0, 1.1


def _puncture():
    def punctured(draws):
        return revolution(np.ones_like, draws[0], draws[1], start=CAP_ANGLE)

    return (
        lambda draws: sphere_points(draws[0], draws[1]),
        lambda draws, scale: scale * sphere_points(draws[0], draws[1]),
        punctured,
        2 * np.sqrt(3),
        2,
        1.0,
        1.1,
    )


_CASES = {"thin handle": _thin_handle, "bridge": _bridge, "puncture": _puncture}
