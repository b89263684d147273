"""Cubic B-splines, of which resampled images are made in matching."""

from __future__ import annotations

from stereomate.jit import inline_kernel


@inline_kernel
def spline_weights(t: float) -> tuple[float, float, float, float]:
    """Weights of the four neighbouring coefficients of a cubic B-spline at fraction t (M. Unser 1999)."""
    u = 1.0 - t
    t2 = t * t
    u2 = u * u
    return (
        u2 * u / 6.0,
        (4.0 - 3.0 * t2 * (1.0 + u)) / 6.0,
        (4.0 - 3.0 * u2 * (1.0 + t)) / 6.0,
        t2 * t / 6.0,
    )
