"""Interior orientation of film: from fiducial marks measured in the scan to the certificate's photo system.

The certificate gives the marks in the fiducial system (millimetres, x right, y up) or only distances between
them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.packing import Affine2
from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions, AdjustmentSummary
from stereomate.geometry.transforms import PlaneKind, PlaneTransform, estimate_plane_transform

Array = NDArray[np.float64]
Point = tuple[float, float]


@dataclass(frozen=True)
class InteriorOrientation:
    """Transform from pixels of one scan to the photo system, with its statistics.

    Attributes
    ----------
    photo_from_pixel : PlaneTransform
        (column, row) to millimetres.
    names : tuple of str
        Marks used, in the order of `residuals_mm`.
    residuals_mm : ndarray, shape (n, 2)
        Certificate minus transformed measurement.
    rms_mm : (float, float)
    rotation : int
        0, 90, 180 or 270: degrees by which the scan is turned clockwise against the fiducial system.
    mirrored : bool
        The scan is mirrored left to right (before it is turned).
    summary : AdjustmentSummary
        ``sigma0`` in units of the a priori standard deviation, redundancy numbers, standardized residuals.
    """

    photo_from_pixel: PlaneTransform
    names: tuple[str, ...]
    residuals_mm: Array
    rms_mm: Point
    rotation: int
    mirrored: bool
    summary: AdjustmentSummary

    @property
    def pitch_mm(self) -> float:
        """Mean size of a pixel of the scan."""
        (a, b, _), (c, d, _) = self.photo_from_pixel.affine
        return math.sqrt(abs(a * d - b * c))

    @property
    def pixel_from_photo(self) -> Affine2:
        """For `Camera`: of a projective transform the numerators."""
        return self.photo_from_pixel.inverse().affine

    @property
    def projective_per_mm(self) -> Point:
        """For `Camera`: the denominator of a projective transform."""
        x, y, _ = self.photo_from_pixel.inverse().matrix[2]
        return x, y


def interior_orientation(
    certificate_mm: Mapping[str, Point],
    measured_px: Mapping[str, Point],
    kind: PlaneKind = "affine",
    sigma_mm: float = 0.005,
    options: AdjustmentOptions | None = None,
) -> InteriorOrientation:
    """Interior orientation from the marks common to certificate and measurement.

    Parameters
    ----------
    certificate_mm : mapping
        Mark -> (x, y) in the fiducial system.
    measured_px : mapping
        Mark -> (column, row) in the scan.
    kind : {"similarity", "affine", "projective"}
    sigma_mm : float
        A priori standard deviation of a coordinate of a mark (certificate and measurement together).
    options : AdjustmentOptions, optional
        ``loss="huber"`` weights confused marks down.

    Raises
    ------
    InputError
        If a measured mark is not in the certificate.
    NotDeterminedError
        If the marks are too few for the transform.
    """
    unknown = sorted(set(measured_px) - set(certificate_mm))
    if unknown:
        raise InputError(
            "must be marks of the certificate", field="measured fiducial marks", value=", ".join(unknown)
        )
    names = tuple(name for name in certificate_mm if name in measured_px)
    target = np.array([certificate_mm[name] for name in names], dtype=np.float64).reshape(-1, 2)
    upright = np.array([measured_px[name] for name in names], dtype=np.float64).reshape(-1, 2) * [1.0, -1.0]
    mirrored = len(names) >= 3 and _is_mirrored(upright, target)
    side = np.array([-1.0 if mirrored else 1.0, 1.0])
    estimate = estimate_plane_transform(kind, upright * side, target, sigma_mm, options)
    flip = np.diag([side[0], -1.0, 1.0])
    transform = PlaneTransform.from_array(kind, np.array(estimate.transform.matrix) @ flip)
    # Mirrored: mm = mirror · turn(θ) = turn(-θ) · mirror, and the estimate acts on mirrored columns.
    turn = estimate.transform.rotation * (-1.0 if mirrored else 1.0)
    rotation = round(turn / (math.pi / 2)) % 4 * 90
    return InteriorOrientation(
        transform, names, estimate.residuals, estimate.rms, rotation, mirrored, estimate.summary
    )


def _is_mirrored(source: Array, target: Array) -> bool:
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    return bool(np.linalg.det(a.T @ b) < 0.0)


@dataclass(frozen=True)
class Arrangement:
    """One way the marks of a certificate can lie on points whose names are unknown.

    Attributes
    ----------
    rotation, mirrored
        As in `InteriorOrientation`.
    marks : tuple of str
        Name of the mark at each point, in the order of the points.
    rms_mm : float
        Root mean square residual of a similarity: how well the arrangement fits.
    """

    rotation: int
    mirrored: bool
    marks: tuple[str, ...]
    rms_mm: float


def possible_arrangements(
    certificate_mm: Mapping[str, Point], points_px: list[Point]
) -> tuple[Arrangement, ...]:
    """All turns and mirrorings of a scan under which found points can be the marks, best fit first.

    Frames are nearly symmetric, so several usually fit within micrometres: what tells them apart is the data
    strip, the shape of the marks or the user. At least three points, all of them marks.
    """
    points = np.array(points_px, dtype=np.float64) * [1.0, -1.0]
    if points.shape[0] < 3 or points.shape[0] > len(certificate_mm):
        raise NotDeterminedError(
            f"an arrangement needs 3 to {len(certificate_mm)} points, got {points.shape[0]}"
        )
    names = tuple(certificate_mm)
    marks = np.array([certificate_mm[name] for name in names])
    middle, extent = (points.max(axis=0) + points.min(axis=0)) / 2, np.ptp(points, axis=0).max() / 2
    reduced = (points - middle) / extent * np.abs(marks).max()
    found = []
    for mirrored, quarter in itertools.product((False, True), range(4)):
        c, s = (1.0, 0.0, -1.0, 0.0)[quarter], (0.0, 1.0, 0.0, -1.0)[quarter]
        turned = reduced @ np.array([[c, -s], [s, c]]).T
        turned = turned * [-1.0 if mirrored else 1.0, 1.0]
        nearest = np.linalg.norm(turned[:, None] - marks[None], axis=2).argmin(axis=1)
        if len(set(nearest.tolist())) < len(points):
            continue
        labels = tuple(names[i] for i in nearest)
        fit = estimate_plane_transform("similarity", turned, marks[nearest])
        rms = float(np.sqrt(np.mean(np.sum(fit.residuals**2, axis=1))))
        found.append(Arrangement(quarter * 90, mirrored, labels, rms))
    return tuple(sorted(found, key=lambda a: a.rms_mm))


@dataclass(frozen=True)
class DistanceAdjustment:
    """Coordinates of fiducial marks from the distances between them.

    Attributes
    ----------
    certificate_mm : dict
        Mark -> (x, y), placed on the nominal layout by its best fit (no scale).
    residuals_mm : dict
        Pair of marks -> measured minus adjusted distance.
    redundancy : int
        Distances that check others.
    assumed : int
        Relations of the marks that no distance determines: they are those of the nominal layout.
    """

    certificate_mm: dict[str, Point]
    residuals_mm: dict[tuple[str, str], float]
    redundancy: int
    assumed: int


def certificate_from_distances(
    nominal_mm: Mapping[str, Point], distances_mm: Mapping[tuple[str, str], float]
) -> DistanceAdjustment:
    """Marks from a certificate that states only distances between them.

    Free network: among all layouts that fit the distances best the one closest to the nominal layout. With
    two opposite distances only, the lines keep the nominal layout's midpoint and right angle.

    Parameters
    ----------
    nominal_mm : mapping
        Mark -> nominal (x, y): which mark is where, to some millimetres.
    distances_mm : mapping
        (mark, mark) -> distance.

    Raises
    ------
    InputError
        If a distance is not positive, names an unknown mark, contradicts the layout, or a mark has none.
    """
    names = tuple(nominal_mm)
    for (one, other), value in distances_mm.items():
        if one not in nominal_mm or other not in nominal_mm or one == other:
            raise InputError(
                "must join two marks of the layout", field=f"distance {one}-{other}", value=value
            )
        if not (math.isfinite(value) and value > 0.0):
            raise InputError("must be positive millimetres", field=f"distance {one}-{other}", value=value)
    lonely = sorted(set(names) - {name for pair in distances_mm for name in pair})
    if lonely:
        raise InputError("must have a distance each", field="fiducial marks", value=", ".join(lonely))
    index = {name: i for i, name in enumerate(names)}
    pairs = np.array([[index[one], index[other]] for one, other in distances_mm])
    measured = np.array(list(distances_mm.values()))
    nominal = np.array([nominal_mm[name] for name in names], dtype=np.float64)
    points, rank = nominal.copy(), 0
    for _ in range(50):
        misfit, design = _distance_equations(points, pairs, measured)
        # Smallest change of the coordinates: keeps what the distances leave free.
        step, _, found_rank, _ = np.linalg.lstsq(design, misfit, rcond=1e-9)
        rank = int(found_rank)
        points = points + step.reshape(-1, 2)
        if np.abs(step).max() < 1e-12 * np.abs(nominal).max():
            break
    else:
        raise InputError("must fit the nominal layout", field="distances between fiducial marks")
    points = _on_nominal(points, nominal)
    misfit, _ = _distance_equations(points, pairs, measured)
    return DistanceAdjustment(
        {name: (float(x), float(y)) for name, (x, y) in zip(names, points, strict=True)},
        {pair: float(v) for pair, v in zip(distances_mm, misfit, strict=True)},
        len(measured) - rank,
        2 * len(names) - 3 - rank,
    )


def _distance_equations(points: Array, pairs: NDArray[np.int64], measured: Array) -> tuple[Array, Array]:
    offsets = points[pairs[:, 0]] - points[pairs[:, 1]]
    lengths = np.linalg.norm(offsets, axis=1)
    design = np.zeros((len(pairs), 2 * len(points)))
    rows = np.arange(len(pairs))
    for axis in (0, 1):
        design[rows, 2 * pairs[:, 0] + axis] = offsets[:, axis] / lengths
        design[rows, 2 * pairs[:, 1] + axis] = -offsets[:, axis] / lengths
    return measured - lengths, design


def _on_nominal(points: Array, nominal: Array) -> Array:
    """Moved and turned onto the nominal layout, unchanged in size."""
    a, b = points - points.mean(axis=0), nominal - nominal.mean(axis=0)
    turn = math.atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
    c, s = math.cos(turn), math.sin(turn)
    result: Array = a @ np.array([[c, s], [-s, c]]) + nominal.mean(axis=0)
    return result
