"""Whether the points determine the orientation: the geometry behind the numbers.

Looked at: standard deviations of the elements, points in one line, no parallax (pure rotation), a plane,
distance from the critical cylinder, and any other orientation that fits the same points as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from stereomate.errors import InputError
from stereomate.relative.coplanarity import CoplanarityAdjustment
from stereomate.relative.kernels.alternatives import other_minimum
from stereomate.relative.kernels.degenerate import correlation_of_rays, rotation_only, square_sum
from stereomate.relative.kernels.pose import share_behind, tangents
from stereomate.relative.kernels.robust import MOST_BEHIND
from stereomate.relative.model import CriticalCylinder, critical_cylinder, flatness, model_points
from stereomate.relative.pair import Correspondences, RelativePose

Array = NDArray[np.float64]

# Inflation times the angle (rad) to the next critical arrangement.
_INFLATION_ANGLE = 25.0
# Of fewer points than this not one may lie behind a camera: it is not outvoted by the others.
_FEW = 12


@dataclass(frozen=True)
class DiagnosisOptions:
    """When an orientation counts as not determined.

    Parameters
    ----------
    largest_standard_deviation_deg : float
        Of the base direction and the rotation, in any direction.
    critical_sigmas : float
        Points are critical if a critical arrangement of them is nearer than so many standard deviations of
        the worst direction: there the normal equations promise what the points do not hold (see
        `GeometryDiagnosis.critical_sigmas`).
    ambiguity : float
        Another orientation is as good if its square sum is larger by less than this (in variances).
    points : int
        Points looked at, chosen evenly.
    samples : int
        Five-point problems in the search for another orientation.
    significance : float
        Probability of calling noise a parallax.
    """

    largest_standard_deviation_deg: float = 2.0
    critical_sigmas: float = 16.0
    ambiguity: float = 25.0
    points: int = 200
    samples: int = 15
    significance: float = 1e-4

    def __post_init__(self) -> None:
        if not self.largest_standard_deviation_deg > 0.0:
            raise InputError("must be positive", field="largest_standard_deviation_deg")
        if self.points < 5 or self.samples < 1:
            raise InputError("points must be at least 5 and samples at least 1", field="points, samples")


@dataclass(frozen=True)
class GeometryDiagnosis:
    """What the arrangement of the points allows.

    Attributes that no decision hangs on are computed when they are first asked for.

    Parameters
    ----------
    reasons : tuple of str
        Why the orientation is not determined; empty if it is.
    largest_standard_deviation_deg : float
        Of base direction and rotation together, in the worst direction of the five.
    parallax_ratio : float
        Root mean square residual of a pure rotation over the noise; near 1 there is no base.
    alternatives : tuple of RelativePose
        Other orientations that fit as well.
    adjustment : CoplanarityAdjustment
        What was judged.
    looked_at : Correspondences
        The points looked at.
    variances : (float, float)
        Noise of left and right coordinates, of a principal distance of one.
    significance : float
        Of the test for a plane.
    """

    reasons: tuple[str, ...]
    largest_standard_deviation_deg: float
    parallax_ratio: float
    alternatives: tuple[RelativePose, ...]
    adjustment: CoplanarityAdjustment = field(repr=False)
    looked_at: Correspondences = field(repr=False)
    variances: tuple[float, float]
    significance: float

    @cached_property
    def _omega(self) -> tuple[float, float]:
        return _strength_of_omega(self.adjustment)

    @cached_property
    def _model(self) -> Array:
        return model_points(self.adjustment.pose, self.looked_at)

    @property
    def cofactor_omega(self) -> float:
        """Variance (rad²) of omega, more exactly of the tilt round the base, for closures of one sigma."""
        return self._omega[0]

    @property
    def inflation_omega(self) -> float:
        """Factor on the standard deviation of that tilt because the other elements are unknown too."""
        return self._omega[1]

    @property
    def critical_sigmas(self) -> float:
        """How far off the next critical arrangement is, in standard deviations of the worst direction.

        Near one, elements are worse known together than each by itself by a factor that is the reciprocal of
        the angle to it, times about 25 in simulated pairs. Points on a critical cylinder come out 2 to 8
        sigmas from it, whatever their noise and number, with errors of up to 7 stated standard deviations:
        there the square sum is no parabola. Ordinary terrain is hundreds of sigmas away.
        """
        return _critical_sigmas(self.largest_standard_deviation_deg, _inflation(self.adjustment))

    @cached_property
    def critical_cylinder(self) -> CriticalCylinder:
        """The cylinder through the base that fits the points best, and how far off it they are."""
        return critical_cylinder(self._model)

    @cached_property
    def flatness(self) -> float:
        """Root mean square distance of the points from a plane over their mean depth."""
        return flatness(self._model)

    @cached_property
    def planar(self) -> bool:
        """The points lie on one plane within their noise."""
        return _on_a_plane(self.looked_at, self.variances, self.significance)


def diagnose(
    adjustment: CoplanarityAdjustment, options: DiagnosisOptions | None = None, seed: int = 0
) -> GeometryDiagnosis:
    """Judge the geometry of an adjusted orientation.

    Noise is taken as the larger of the prior and the estimated standard deviation.
    """
    options = options or DiagnosisOptions()
    pose = adjustment.pose
    used = np.flatnonzero(adjustment.weights > 0.0)
    if len(used) > options.points:
        used = used[np.linspace(0, len(used) - 1, options.points).astype(int)]
    chosen = adjustment.correspondences.select(used)
    noise = max(1.0, adjustment.sigma0 if math.isfinite(adjustment.sigma0) else 1.0)
    variances = _variances(chosen, noise)
    reasons: list[str] = []

    worst = math.inf
    if not adjustment.singular:
        worst = math.degrees(math.sqrt(float(np.linalg.eigvalsh(adjustment.cofactor)[-1])) * noise)
    if _on_a_line(chosen, variances):
        reasons.append("the points lie on one line in a photograph")
    elif not worst <= options.largest_standard_deviation_deg:
        reasons.append(
            "the points do not determine the elements: "
            + ("singular normal equations" if adjustment.singular else _standard_deviation(worst))
        )
    elif _critical_sigmas(worst, _inflation(adjustment)) < options.critical_sigmas:
        reasons.append(
            "the points lie on a critical surface (as a cylinder through both centres) within their noise, "
            "or in too small a part of the overlap: the elements are "
            f"{_inflation(adjustment):.0f} times worse known together than each by itself"
        )
    ratio, no_parallax = _pure_rotation(chosen, variances, options)
    if no_parallax:
        reasons.append("no parallax: the photographs differ by a rotation only, the base is unknown")

    alternatives = _alternatives(chosen, pose, variances, options, seed)
    if alternatives and not no_parallax:
        planar = _on_a_plane(chosen, variances, options.significance)
        kind = "the points lie on one plane" if planar else "critical arrangement of the points"
        reasons.append(f"{kind}: another orientation fits them as well")
    behind = _behind(chosen, pose, sum(variances))
    if not reasons and behind > (0 if len(chosen) < _FEW else MOST_BEHIND * len(chosen)):
        reasons.append(f"{behind} of {len(chosen)} points lie behind a camera")
    return GeometryDiagnosis(
        tuple(reasons), worst, ratio, alternatives, adjustment, chosen, variances, options.significance
    )


def why_no_orientation(c: Correspondences) -> str:
    """What is wrong with points to which no orientation can be found at all."""
    variances = _variances(c, 1.0)
    if _on_a_line(c, variances):
        return "the points lie on one line in a photograph"
    if _pure_rotation(c, variances, DiagnosisOptions())[1]:
        return "no parallax: the photographs differ by a rotation only, the base is unknown"
    return "no orientation has the points before both cameras"


def _standard_deviation(worst: float) -> str:
    return f"standard deviation {worst:.1f}°" if worst < 90.0 else "standard deviation beyond 90°"


def _behind(c: Correspondences, pose: RelativePose, variance: float) -> int:
    """Points behind a camera by more than their noise."""
    everything = np.ones(len(c), dtype=np.bool_)
    share = share_behind(
        c.left, c.right, everything, np.array(pose.base), np.array(pose.left_from_right), variance
    )
    return round(share * len(c))


def _variances(c: Correspondences, noise: float) -> tuple[float, float]:
    left, right = (
        0.5 * noise**2 * (float(v[0, 0] + v[0, 2]) if len(v) == 1 else float(np.median(v[:, 0] + v[:, 2])))
        for v in (c.left_covariance, c.right_covariance)
    )
    return left, right


def _on_a_line(c: Correspondences, variances: tuple[float, float]) -> bool:
    for points, variance in ((c.left, variances[0]), (c.right, variances[1])):
        x, y = (points - points.mean(axis=0)).T
        xx, xy, yy = (float(a @ b) / (len(c) - 1) for a, b in ((x, x), (x, y), (y, y)))
        # Smaller eigenvalue of the scatter.
        across = 0.5 * (xx + yy - math.hypot(xx - yy, 2.0 * xy))
        if across < 25.0 * variance + 1e-18:
            return True
    return False


def _pure_rotation(
    c: Correspondences, variances: tuple[float, float], options: DiagnosisOptions
) -> tuple[float, bool]:
    """Root mean square residual of a rotation alone over the noise, and whether it explains the points."""
    correlation = np.empty((3, 3))
    correlation_of_rays(c.left, c.right, correlation)
    u, _, v = np.linalg.svd(correlation)
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
    # Two Gauss-Newton steps from directions to photo coordinates.
    total = rotation_only(c.left, c.right, rotation, 2) / (variances[0] + variances[1])
    freedom = 2 * len(c) - 3
    return math.sqrt(total / freedom), total < float(chdtri(freedom, options.significance))


def _on_a_plane(c: Correspondences, variances: tuple[float, float], significance: float) -> bool:
    """A homography explains the points within their noise: they lie on one plane (or there is no base)."""
    if len(c) < 6:
        return True
    x, y = c.right[:, 0], c.right[:, 1]
    u, v = c.left[:, 0], c.left[:, 1]
    one, zero = np.ones(len(c)), np.zeros(len(c))
    h, w = np.eye(3), one
    for _ in range(3):
        # Divided by the denominator of the step before, the equations are those of the image coordinates.
        by_u = np.column_stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u]) / w[:, None]
        by_v = np.column_stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v]) / w[:, None]
        h = np.linalg.eigh(by_u.T @ by_u + by_v.T @ by_v)[1][:, 0].reshape(3, 3)
        w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
        w = np.where(np.abs(w) > 1e-9, w, 1e-9)
    p = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
    q = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
    magnification = np.abs(np.linalg.det(h) / w**3)
    variance = variances[0] + variances[1] * magnification
    total = float(np.sum(((u - p) ** 2 + (v - q) ** 2) / variance))
    return total < float(chdtri(max(2 * len(c) - 8, 1), significance))


def _alternatives(
    c: Correspondences,
    pose: RelativePose,
    variances: tuple[float, float],
    options: DiagnosisOptions,
    seed: int,
) -> tuple[RelativePose, ...]:
    state = np.array([(seed + 1) * 0x9E3779B97F4A7C15 % 2**64 | 1], dtype=np.uint64)
    base, rotation = np.zeros(3), np.zeros((3, 3))
    total, _share = other_minimum(
        c.left,
        c.right,
        variances[0],
        variances[1],
        options.samples,
        state,
        np.array(pose.base),
        np.array(pose.left_from_right),
        base,
        rotation,
    )
    if not math.isfinite(total):
        return ()
    from_here = square_sum(pose.essential.ravel(), c.left, c.right, *variances)
    return (RelativePose(base, rotation),) if total - from_here < options.ambiguity else ()


def _critical_sigmas(worst_deg: float, inflation: float) -> float:
    return _INFLATION_ANGLE / (inflation * math.radians(worst_deg)) if worst_deg > 0.0 else math.inf


def _inflation(adjustment: CoplanarityAdjustment) -> float:
    """Largest factor on a standard deviation because the other elements are unknown too."""
    normal = np.linalg.inv(_round_the_base(adjustment))
    scale = 1.0 / np.sqrt(np.diag(normal))
    smallest = float(np.linalg.eigvalsh(normal * np.outer(scale, scale))[0])
    return 1.0 / math.sqrt(smallest) if smallest > 0.0 else math.inf


def _strength_of_omega(adjustment: CoplanarityAdjustment) -> tuple[float, float]:
    """Cofactor of the tilt round the base, and the root of its variance inflation by the other elements."""
    if adjustment.singular:
        return math.inf, math.inf
    cofactor = _round_the_base(adjustment)
    normal = np.linalg.inv(cofactor)
    return float(cofactor[2, 2]), math.sqrt(max(float(cofactor[2, 2] * normal[2, 2]), 1.0))


def _round_the_base(adjustment: CoplanarityAdjustment) -> Array:
    """Cofactor with the rotation in axes along and across the base, shape (5, 5)."""
    across = np.empty((2, 3))
    tangents(np.array(adjustment.pose.base), across)
    turned = np.eye(5)
    turned[2:, 2:] = np.vstack([adjustment.pose.base, across])
    cofactor: Array = turned @ adjustment.cofactor @ turned.T
    return cofactor
