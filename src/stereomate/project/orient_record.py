"""The result of an orientation as plain numbers: `adjustment.json`, and the tables behind it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate import __version__
from stereomate.forms import ORIENTATION
from stereomate.frames.attitude import AttitudeConvention, written_from_axes
from stereomate.frames.transform import map_from_tangent
from stereomate.project.orient_adjust import Adjusted
from stereomate.project.orient_camera_record import calibration_findings, camera_records
from stereomate.project.orient_compare import comparisons, findings_of
from stereomate.project.orient_control_record import control_record, number, numbers
from stereomate.project.orient_expected import expected_accuracy, expected_finding
from stereomate.project.orient_inputs import OrientInputs, heights_are_verified
from stereomate.project.orient_measure import Measured
from stereomate.project.orient_quality import judged_accuracy, observation_groups
from stereomate.project.orient_strips_record import strip_findings, strips_record

Array = NDArray[np.float64]

_OPK: Final = AttitudeConvention("opk", "local", "deg")
# A photograph whose angles contradict its stated ones by more than this is named.
_TURNED: Final = math.radians(20.0)
# Part of the positions that single gross errors do not reach.
_MANY: Final = 0.1
# Of a list in a finding; all are in the tables.
_NAMED: Final = 6


@dataclass(frozen=True, eq=False)
class OrientedPhotos:
    """Adjusted photographs in the map of the project (or in the frame of the model without a datum).

    Attributes
    ----------
    names, cameras : tuple of str
    positions : ndarray, shape (n, 3)
    rotations : ndarray, shape (n, 3, 3)
        From camera axes to local axes (east, north, up at each centre).
    opk_deg : ndarray, shape (n, 3)
    """

    names: tuple[str, ...]
    cameras: tuple[str, ...]
    positions: Array
    rotations: Array
    opk_deg: Array


def oriented_photos(inputs: OrientInputs, adjusted: Adjusted) -> OrientedPhotos:
    """The adjusted orientations as they are written."""
    result = adjusted.result
    names = tuple(inputs.photos[k].path.name for k in adjusted.oriented)
    cameras = tuple(inputs.photos[k].camera.name for k in adjusted.oriented)
    positions, rotations = result.centres, result.rotations
    if adjusted.has_datum and inputs.tangent is not None:
        tangent = inputs.tangent
        lon, lat, _ = tangent.geodetic_from_tangent(result.centres).T
        local = tangent.rotation_tangent_from_enu(lon, lat)
        rotations = np.swapaxes(local, -1, -2) @ result.rotations
        positions = map_from_tangent(tangent, inputs.frame, result.centres)
    return OrientedPhotos(names, cameras, positions, rotations, written_from_axes(rotations, _OPK))


def adjustment_record(
    inputs: OrientInputs, measured: Measured, adjusted: Adjusted, photos: OrientedPhotos, key: str
) -> dict[str, Any]:
    """Everything of `adjustment.json`; no times, so that a run repeated gives the same bytes."""
    result = adjusted.result
    cameras = camera_records(result, inputs.file.orient.significance)
    expected = expected_accuracy(measured, adjusted)
    comparison, control = comparisons(inputs, adjusted), control_record(inputs, adjusted)
    navigation = strips_record(adjusted.data.groups, adjusted.assembled.photos, result, adjusted.strips)
    x, y = result.rms_px
    used = result.used
    rays = np.bincount(result.network.image.photo[used], minlength=len(photos.names))
    return {
        "format": ORIENTATION.version,
        "kind": "block adjustment",
        "software": f"stereomate {__version__}",
        "key": key,
        "project": inputs.file.project.name or inputs.path.stem,
        "frame": _frame(inputs, adjusted),
        "summary": {
            "photographs": len(inputs.photos),
            "oriented": len(photos.names),
            "tie_points": int(np.isfinite(result.points[: len(adjusted.assembled.ties), 0]).sum()),
            "image_points": int(used.sum()),
            "observations": result.observations,
            "unknowns": result.unknowns,
            "redundancy": result.redundancy,
            "sigma0": number(result.sigma0),
            "global_test": None if result.test is None else vars(result.test),
            "converged": result.converged,
            "iterations": result.iterations,
            "image_rms_px": {"columns": number(x), "rows": number(y)},
            "gross_errors": len(result.gross_errors),
        },
        "findings": [
            *findings_of(comparison),
            *_taken_out(adjusted),
            *strip_findings(navigation, inputs.positions.sigma_m),
            *_height_findings(inputs, adjusted),
            *_turned(inputs, adjusted),
            *adjusted.findings,
            *calibration_findings(cameras, result),
            *expected_finding(expected),
        ],
        "measurement": {
            "pairs": len(measured.pairs),
            "pairs_oriented": sum(not pair.reasons for pair in measured.pairs),
            "chosen": measured.selection,
            **measured.counts,
        },
        "cameras": cameras,
        "photographs": _photographs(adjusted, photos, rays),
        "not_oriented": _not_oriented(inputs, measured, adjusted),
        "positions": _positions(inputs, adjusted),
        "navigation": navigation,
        "control": control,
        "accuracy": judged_accuracy(inputs.file.accuracy, control),
        "observations": observation_groups(result),
        "expected": expected,
        "comparison": comparison,
        "y_parallaxes": y_parallaxes(adjusted, photos.names),
        "correlations": [vars(c) for c in result.correlations],
        "gross_errors": [
            {
                "kind": error.kind,
                "place": error.place,
                "size": [number(v) for v in error.size],
                "standardized": number(error.standardized),
                "in_doubt": error.in_doubt,
            }
            for error in result.gross_errors
        ],
        "notes": list(inputs.notes),
    }


def _frame(inputs: OrientInputs, adjusted: Adjusted) -> dict[str, Any]:
    if not adjusted.has_datum or inputs.tangent is None:
        return {"datum": "none", "axes": "of the model: place, direction and scale are arbitrary"}
    tangent = inputs.tangent
    return {
        "datum": "control" if inputs.control is not None else inputs.positions.source,
        "crs": inputs.frame.crs,
        "heights": inputs.frame.heights.description,
        "tangent_origin": [tangent.longitude_deg, tangent.latitude_deg, tangent.height_m],
        "angles": "omega, phi, kappa in degrees about east, north, up at each projection centre",
    }


def _height_findings(inputs: OrientInputs, adjusted: Adjusted) -> list[str]:
    if not adjusted.has_datum or heights_are_verified(inputs) or inputs.control is not None:
        return []
    if inputs.positions.source != "exif":
        return []
    heights = inputs.positions.geographic[:, 2]
    text = (
        "the height datum is unverified: altitudes of EXIF say above sea level and are ellipsoidal with many "
        "drones; nothing in the project tells which"
    )
    if np.isfinite(heights).any():
        text += f" (they are {np.nanmin(heights):.1f} to {np.nanmax(heights):.1f} m)"
    return [text]


def _taken_out(adjusted: Adjusted) -> list[str]:
    """Control, positions and attitudes that the tests took out, with their sizes."""
    result = adjusted.result
    found = []
    for kind, words in (
        ("control", "control points"),
        ("positions", "positions"),
        ("attitudes", "attitudes"),
    ):
        errors = [error for error in result.gross_errors if error.kind == kind]
        if not errors:
            continue
        unit = "rad" if kind == "attitudes" else "m"
        listed = "; ".join(
            f"{error.place} {', '.join('-' if np.isnan(v) else f'{v:+.3g}' for v in error.size)} {unit}"
            for error in errors[:_NAMED]
        )
        places = len({error.place for error in errors})
        text = f"{places} {words} contradict the rest and were taken out, wholly or in part: {listed}"
        if places > _NAMED:
            text += f" and {len(errors) - _NAMED} more"
        observed = result.network.positions
        if kind == "positions" and observed is not None and places > max(3.0, _MANY * len(observed.photo)):
            text += "; so many are no single errors: a strip with a shift of its own, or a camera parameter?"
        found.append(text)
    return found


def _turned(inputs: OrientInputs, adjusted: Adjusted) -> list[str]:
    """Photographs whose stated angles are far from those found."""
    if not adjusted.has_datum:
        return []
    found: dict[int, list[str]] = {}
    for k, photo in enumerate(adjusted.oriented):
        stated = inputs.positions.attitudes[photo]
        if not np.isfinite(stated).all():
            continue
        turn = stated.T @ adjusted.result.rotations[k]
        angle = math.acos(max(-1.0, min(1.0, (float(np.trace(turn)) - 1.0) / 2.0)))
        if angle > _TURNED:
            quarter = round(math.degrees(angle) / 90.0) * 90
            turned = abs(math.degrees(angle) - quarter) < math.degrees(_TURNED) and quarter > 0
            found.setdefault(quarter if turned else 0, []).append(inputs.photos[photo].name)
    return [
        (
            f"{len(names)} photographs are turned by about {angle}° against their stated angles (their "
            f"pixels are stored so): {', '.join(names[:8])}"
            if angle
            else f"{len(names)} photographs lie otherwise than their stated angles say, by more than "
            f"{math.degrees(_TURNED):.0f}°: {', '.join(names[:8])}"
        )
        for angle, names in sorted(found.items())
    ]


def _photographs(adjusted: Adjusted, photos: OrientedPhotos, rays: NDArray[np.int64]) -> list[dict[str, Any]]:
    statistics = adjusted.result.statistics
    sigma = statistics.photo_sigma if statistics is not None else np.full((len(photos.names), 6), math.nan)
    square = _mean_square_residuals(adjusted, len(photos.names))
    return [
        {
            "name": name,
            "camera": photos.cameras[k],
            "position": numbers(photos.positions[k]),
            "omega_phi_kappa_deg": numbers(photos.opk_deg[k]),
            "standard_deviation_m": numbers(sigma[k, :3]),
            "standard_deviation_deg": numbers(np.degrees(sigma[k, 3:])),
            "image_points": int(rays[k]),
            "image_rms_px": number(math.sqrt(square[k])),
        }
        for k, name in enumerate(photos.names)
    ]


def _mean_square_residuals(adjusted: Adjusted, count: int) -> Array:
    """Mean square of a coordinate of the image residuals of each photograph, pixels²; NaN without points."""
    result = adjusted.result
    photo = result.network.image.photo[result.used]
    squares = np.sum(result.residuals[result.used] ** 2, axis=1)
    total = np.bincount(photo, squares, minlength=count)
    points = np.bincount(photo, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(total / (2.0 * points))


def _not_oriented(inputs: OrientInputs, measured: Measured, adjusted: Adjusted) -> list[dict[str, str]]:
    reasons = {inputs.photos[k].path.name: reason for k, reason in adjusted.left_out.items()}
    reasons |= {problem.name: str(problem.error) for problem in (*inputs.problems, *measured.problems)}
    return [{"name": name, "reason": reason} for name, reason in sorted(reasons.items())]


def _positions(inputs: OrientInputs, adjusted: Adjusted) -> dict[str, Any] | None:
    statistics, observed = adjusted.result.statistics, adjusted.result.network.positions
    if statistics is None or observed is None or statistics.positions is None:
        return None
    part = statistics.positions
    rms = np.sqrt(np.nanmean(part.residuals**2, axis=0))
    names = adjusted.result.network.photographs.names
    return {
        "source": inputs.positions.source,
        "sigma_m": list(inputs.positions.sigma_m),
        "rms_m": numbers(rms),
        "rms_plan_m": number(float(np.hypot(rms[0], rms[1]))),
        "mean_m": numbers(np.nanmean(part.residuals, axis=0)),
        "residuals": [
            {"name": names[photo], "residual_m": numbers(part.residuals[k]),
             "standardized": numbers(part.standardized[k]), "redundancy": numbers(part.redundancy[k]),
             "detectable_m": numbers(part.minimal_detectable[k])}
            for k, photo in enumerate(observed.photo.tolist())
        ],
    }  # fmt: skip


def y_parallaxes(adjusted: Adjusted, names: Sequence[str]) -> list[dict[str, Any]]:
    """Remaining y-parallax of every pair that shares tie points: how far rays miss each other, pixels.

    The difference of the residuals of a point in both photographs, at right angles to the epipolar line in
    the second.
    """
    result = adjusted.result
    image = result.network.image
    rows = np.flatnonzero(result.used & (image.point < len(adjusted.assembled.ties)))
    of_photo = {k: rows[image.photo[rows] == k] for k in range(len(names))}
    record = []
    for a in range(len(names)):
        for b in range(a + 1, len(names)):
            common, i, j = np.intersect1d(
                image.point[of_photo[a]], image.point[of_photo[b]], return_indices=True
            )
            if len(common) < 5:
                continue
            first, second = of_photo[a][i], of_photo[b][j]
            across = _across_epipolar(adjusted, a, b, image.xy[first], common)
            back = _across_epipolar(adjusted, b, a, image.xy[second], common)
            parallax = np.sum(result.residuals[second] * across, axis=1) - np.sum(
                result.residuals[first] * back, axis=1
            ) * np.sign(np.sum(across * back, axis=1))
            good = parallax[np.isfinite(parallax)]
            if good.size:
                record.append({"left": names[a], "right": names[b], "points": int(good.size),
                               "rms_px": number(math.sqrt(float(np.mean(good**2))))})  # fmt: skip
    return record


def _across_epipolar(adjusted: Adjusted, a: int, b: int, pixels: Array, points: NDArray[np.int64]) -> Array:
    """Unit vectors in photograph b at right angles to the epipolar lines of points of photograph a."""
    result = adjusted.result
    camera = result.cameras[int(result.network.photographs.camera[b])]
    ground = result.points[points]
    towards = ground - result.centres[a]
    seen = []
    for share in (1.0, 1.001):
        local = (result.centres[a] + share * towards - result.centres[b]) @ result.rotations[b]
        seen.append(camera.image_from_camera(np.nan_to_num(local))[0])
    along = seen[1] - seen[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.column_stack([-along[:, 1], along[:, 0]])
