"""When the topology term acts and how strongly: the ramp and the calibration of its weight (paper §3.4)."""

from __future__ import annotations

import math

from paper_artifact.errors import InputError

# ‖∇V L_topo‖ ÷ ‖∇V L_photo‖ at calibration below which no weight is set: a term whose gradient is rounding
# alone would get λ = 5e14. The smallest ratio of the recorded runs is 1.3e-3 (torus, C6, seed 3).
LEAST_RATIO = 1e-5


def ramp_factor(step: int, steps: int, window: tuple[float, float] | None) -> float:
    """Return the factor in [0, 1] of λ at `step` of `steps`.

    0 up to window[0]·steps, 1 from window[1]·steps, linear between. window None (condition C3, no ramp): 1 at
    every step. Raises InputError for a window that is not 0 <= start < end <= 1.
    """
    if window is None:
        return 1.0
    start, end = window
    if not 0 <= start < end <= 1:
        raise InputError(f"the ramp must be two fractions 0 <= start < end <= 1, got {window}")
    return min(1.0, max(0.0, (step / steps - start) / (end - start)))


def peak_weight(rho: float, photo_norm: float, topo_norm: float) -> float | None:
    """Return λ_peak = ρ ‖∇V L_photo‖ / ‖∇V L_topo‖, or None where `no_weight` has a reason against it.

    None is a stated no-op: the term stays out of this step, the log says so, and the next step tries again.
    """
    return None if no_weight(rho, photo_norm, topo_norm) else rho * photo_norm / topo_norm


def no_weight(rho: float, photo_norm: float, topo_norm: float) -> str:
    """Return why no weight can be set from these norms; an empty text when one can."""
    for name, norm in (("topology", topo_norm), ("photometric", photo_norm)):
        if not math.isfinite(norm) or norm <= 0:
            return f"the {name} gradient is zero or not finite, no weight can be set"
    if topo_norm < LEAST_RATIO * photo_norm:
        return (
            f"the topology gradient is {topo_norm / photo_norm:.1e} of the photometric one, below "
            f"{LEAST_RATIO:g}: too little to set a weight by"
        )
    weight = rho * photo_norm / topo_norm
    return "" if math.isfinite(weight) and weight > 0 else "the weight is zero or not finite"
