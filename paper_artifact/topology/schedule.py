"""When the topology term acts and how strongly: the ramp and the calibration of its weight (paper §3.4)."""

from __future__ import annotations

import math

from paper_artifact.errors import InputError


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
    """Return λ_peak = ρ ‖∇V L_photo‖ / ‖∇V L_topo‖, or None where a norm is zero or not finite.

    None is a stated no-op: the term stays out of this step, the log says so, and the next step tries again.
    """
    if not (math.isfinite(photo_norm) and math.isfinite(topo_norm)) or photo_norm <= 0 or topo_norm <= 0:
        return None
    weight = rho * photo_norm / topo_norm
    return weight if math.isfinite(weight) and weight > 0 else None
