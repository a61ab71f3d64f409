"""The pre-registered rule: which observable, at which density (paper §4, §6, suppl. B and G).

1. The expected bars are the certified ones, (b0 - 1, b1, b2). Where no certificate of a closed surface
   exists, or none of its classes is measurable, they are those that the clean surface itself shows at the
   largest working density (the bowls: an open mouth caps).
2. The class is the first dimension of H0, H1, H2 that is expected and has a significant bar at some working
   density.
3. The density is the first working density at which all expected bars of the class are significant
   ("complete"); if there is none, the first at which any is, and the loss is restricted to what is measurable
   ("partial": the torus and rocker-arm precedent).
4. The loss also acts on every other expected dimension that is complete at this density, and on nothing else.

The working densities are the study's two, M = 2048 and, where that is too coarse, M = 8192. The other rungs
of the staircase are diagnostics: eight is complete at 4096 already, and the paper bundles it at 8192. A bar
is significant iff its lifetime exceeds 6·r_med(M).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from paper_artifact.certify.certificate import Certificate
from paper_artifact.errors import InputError
from paper_artifact.mesh import FEATURES, betti_text

DENSITIES = (512, 1024, 2048, 4096, 8192, 20_000)
WORKING = (2048, 8192)
NEAR = 0.15  # of the floor: margins vary by about this much between sampling seeds
NAMES = ("components (H0)", "loops (H1)", "voids (H2)")


@dataclass(frozen=True)
class Rung:
    """One density of the staircase."""

    samples: int  # M
    seed: int  # of the samples
    floor: float  # 6·r_med(M), radius / diagonal
    margins: tuple[tuple[float, ...], ...]  # per dimension the bars' lifetimes over the floor, longest first

    @property
    def counts(self) -> tuple[int, int, int]:
        """The numbers of significant finite bars per dimension, without the one infinite bar of H0."""
        h0, h1, h2 = (sum(margin > 1 for margin in each) for each in self.margins)
        return h0, h1, h2

    @property
    def signature(self) -> str:
        """The counts as the paper writes them, H0 with its infinite bar."""
        h0, h1, h2 = self.counts
        return f"({h0 + 1},{h1},{h2})"


@dataclass(frozen=True)
class Decision:
    """What the rule says of a mesh."""

    dimension: int | None  # the observable class: 0, 1 or 2; None when nothing is measurable
    samples: int | None  # M, the working density; None when nothing is measurable
    dimensions: tuple[int, ...]  # where the loss acts
    complete: bool  # whether all expected bars of the class are significant
    expected: tuple[int, int, int]  # finite bars per dimension
    basis: str  # of the expectation: "certificate" or "observation"
    reasons: tuple[str, ...]  # the rule's steps as sentences
    warnings: tuple[str, ...]  # what an evaluation at a denser sample would stumble over


def counted(dimension: int, found: int, expected: int) -> str:
    """Return how many of the expected classes were found in words, "1 of 2 loops".

    Both are numbers of finite bars, so the first component, which no bar tells of, is added to either.
    """
    first = int(dimension == 0)
    return f"{found + first} of {expected + first} {FEATURES[dimension][expected + first != 1]}"


def decide(rungs: Sequence[Rung], certificate: Certificate, working: Sequence[int] = WORKING) -> Decision:
    """Return the Decision for the staircase `rungs` (one per density, any order) and the certificate of a
    mesh.

    Raises InputError when a working density has no rung.
    """
    by_samples = {rung.samples: rung for rung in sorted(rungs, key=lambda each: each.samples)}
    missing = [samples for samples in working if samples not in by_samples]
    if missing or not working:
        raise InputError(
            f"the staircase has no rung at the working density {missing or ''}; measure it there"
        )
    ladder = [by_samples[samples] for samples in sorted(working)]
    reasons = []
    observed = ladder[-1].counts
    if certificate.passed and certificate.closed:
        certified = (certificate.betti[0] - 1, certificate.betti[1], certificate.betti[2])
        reasons.append(f"The certificate passes; expected are {betti_text(certificate.betti)}.")
        choices = [("certificate", certified), ("observation", observed)]
    else:
        why = "is that of a surface with boundary" if certificate.passed else "fails"
        seen = betti_text((observed[0] + 1, *observed[1:]))
        reasons.append(
            f"The certificate {why}, so what is observed at M = {ladder[-1].samples} is expected: {seen}."
        )
        choices = [("observation", observed)]
    for basis, expected in choices:
        if basis == "observation" and len(choices) == 2:
            reasons.append("No certified class is measurable; the bars observed without one decide.")
        for dimension in range(3):
            found = _density(ladder, dimension, expected[dimension])
            if found is not None:
                return _decision(by_samples, *found, dimension, expected, basis, reasons)
            if expected[dimension]:
                longest = [max(rung.margins[dimension], default=0.0) for rung in ladder]
                tops = zip(ladder, longest, strict=True)
                shown = ", ".join(f"M = {rung.samples}: {top:.2f} of the floor" for rung, top in tops)
                reasons.append(
                    f"Only {counted(dimension, 0, expected[dimension])} clear the floor at a "
                    f"working density ({shown})."
                )
    denser = [rung for rung in by_samples.values() if sum(rung.counts) and rung.samples not in working]
    if denser:
        reasons.append(
            f"Bars appear at M = {', '.join(str(rung.samples) for rung in denser)} only, "
            "which is no working density."
        )
    basis, expected = choices[0]
    return Decision(None, None, (), False, expected, basis, tuple(reasons), warnings=())


def _density(ladder: Sequence[Rung], dimension: int, expected: int) -> tuple[Rung, bool] | None:
    if expected == 0:
        return None
    for rung in ladder:
        if rung.counts[dimension] >= expected:
            return rung, True
    return next(((rung, False) for rung in ladder if rung.counts[dimension]), None)


def _decision(
    by_samples: dict[int, Rung],
    rung: Rung,
    complete: bool,
    dimension: int,
    expected: tuple[int, int, int],
    basis: str,
    reasons: list[str],
) -> Decision:
    others = tuple(d for d in range(3) if d != dimension and expected[d] and rung.counts[d] == expected[d])
    shown = counted(dimension, rung.counts[dimension], expected[dimension])
    tightest = f"tightest {min(margin for margin in rung.margins[dimension] if margin > 1):.2f} of the floor"
    if complete:
        reasons.append(f"M = {rung.samples} is the first working density that shows {shown} ({tightest}).")
    else:
        reasons.append(
            f"No working density shows all; M = {rung.samples} is the first that shows any, {shown} "
            f"({tightest}), and the loss is restricted to it."
        )
    left = [d for d in range(3) if d != dimension and d not in others and (expected[d] or rung.counts[d])]
    reasons += [f"Left out: {counted(d, rung.counts[d], expected[d])} at M = {rung.samples}." for d in left]
    warnings = [
        f"M = {denser.samples} shows {denser.counts[d] + (d == 0)} {FEATURES[d][1]} where "
        f"{expected[d] + (d == 0)} are expected: a concavity that caps, or a real feature of the clean "
        "surface; a count there is no phantom of a reconstruction."
        for denser in by_samples.values()
        if denser.samples >= rung.samples
        for d in range(3)
        if denser.counts[d] > expected[d]
    ]
    warnings += [
        f"The {NAMES[d]} lie within {100 * NEAR:.0f} % of the floor at M = {rung.samples}: "
        "another sampling seed may decide otherwise."
        for d in range(3)
        if any(abs(margin - 1) < NEAR for margin in rung.margins[d][: max(expected[d], 1)])
    ]
    dimensions = tuple(sorted((dimension, *others)))
    return Decision(
        dimension, rung.samples, dimensions, complete, expected, basis, tuple(reasons), tuple(warnings)
    )
