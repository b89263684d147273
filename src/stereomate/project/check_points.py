"""Check of an orientation by points of known coordinates: their rays intersected, against the coordinates.

The points of ``[control]`` with image measurements took no part in making the orientation that a project is
given, as far as a run knows; whether they did is for the user to say.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.formats.image_points import ImageMeasurements
from stereomate.frames.transform import map_from_tangent
from stereomate.geometry.accuracy import PointAccuracy, point_accuracy
from stereomate.geometry.intersection import Intersections, Rays, intersect_rays
from stereomate.project.model import Project
from stereomate.project.orient_control import Control, control_table, read_block_control
from stereomate.project.orientations import Reading
from stereomate.project.reading import read_project_file
from stereomate.project.schema import ControlSection

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CheckPoints:
    """Points of known coordinates against the intersection of their rays.

    Attributes
    ----------
    names : tuple of str (n,)
        Points with at least two rays.
    map_xy : ndarray (n, 2)
        Map of the project; NaN for points that are not known in all three coordinates.
    differences_m : ndarray (n, 3)
        Intersection minus given: east, north, up at the point; NaN for axes that are not known.
    sigma_m : ndarray (n, 3)
        Stated standard deviations of the points.
    measured_sigma_m : ndarray (n, 3)
        Standard deviations of the intersection from those of the image measurements alone.
    rays : ndarray of int (n,)
    image_rms_px : float
        Root mean square residual of the image measurements, per axis.
    left_out : tuple of str
        Points with fewer than two rays, or whose rays do not meet.
    independent : bool
        Whether it is known that they took no part in the orientation.
    """

    names: tuple[str, ...]
    map_xy: Array
    differences_m: Array
    sigma_m: Array
    measured_sigma_m: Array
    rays: NDArray[np.int64]
    image_rms_px: float
    left_out: tuple[str, ...]
    independent: bool = False

    @property
    def accuracy(self) -> PointAccuracy:
        """The differences in the terms of the standards."""
        return point_accuracy(self.differences_m, self.sigma_m)

    def as_record(self) -> dict[str, Any]:
        """For JSON."""
        points = [
            {
                "name": name,
                "difference_m": [None if np.isnan(v) else float(v) for v in difference],
                "sigma_m": [float(v) for v in sigma],
                "measured_sigma_m": [float(v) for v in measured],
                "rays": int(rays),
            }
            for name, difference, sigma, measured, rays in zip(
                self.names, self.differences_m, self.sigma_m, self.measured_sigma_m, self.rays, strict=True
            )
        ]
        return {
            "points": points,
            "image_rms_px": self.image_rms_px,
            "left_out": list(self.left_out),
            "accuracy": self.accuracy.as_record(),
        }


def check_points(project: Project) -> CheckPoints | None:
    """Check the orientation of a project by its points; None where it names none or their measurements.

    Raises
    ------
    ProjectError, FormatError, CrsError, HeightSystemError
        About the files of the points.
    """
    file = read_project_file(project.path)
    if file.control is None or (
        file.control.measurements is None and not _has_measurements(file.control, project.path.parent)
    ):
        return None
    frame = project.frame
    reading = Reading(project.path, "control", project.path.parent, file.project.crs, frame.heights)
    names = [photograph.name for photograph in project.survey.photographs]
    control = read_block_control(file, project.path, reading, names)
    if control is None or control.measurements is None:
        return None
    return intersected(project, control.placed(project.tangent, frame))


def _has_measurements(section: ControlSection, folder: Path) -> bool:
    """Whether a file of its own, or the list of points itself, says where they are in the photographs."""
    if section.measurements is not None:
        return True
    return control_table(folder / section.file, section.columns, section.separator).measurements is not None


def intersected(project: Project, control: Control) -> CheckPoints:
    """Intersect the rays of every point of `control`, placed in the tangent frame."""
    assert control.measurements is not None
    rays, sigma_px = _rays(project, control, control.measurements)
    count = len(control.names)
    rays_of = np.bincount(rays.point, minlength=count)
    found = intersect_rays(rays, count)
    good = (rays_of >= 2) & found.converged
    return CheckPoints(
        tuple(name for name, ok in zip(control.names, good, strict=True) if ok),
        _map_positions(project, control)[good],
        _local_differences(project, control, found.points)[good],
        control.sigma_m[good],
        _local_sigma(project, found)[good],
        rays_of[good],
        _image_rms(found, rays, sigma_px, good),
        tuple(name for name, ok in zip(control.names, good, strict=True) if not ok),
    )


def _rays(project: Project, control: Control, measurements: ImageMeasurements) -> tuple[Rays, Array]:
    """Rays of the measurements in photographs of the survey, and their standard deviations in pixels."""
    photographs = project.survey.photographs
    by_name = {p.name: k for k, p in enumerate(photographs)}
    by_stem = {Path(p.name).stem: k for k, p in enumerate(photographs)}
    point_of = {name: k for k, name in enumerate(control.names)}
    point, centres, rotations, image, sigma, sigma_px = [], [], [], [], [], []
    for name, photo, pixel, stated in zip(
        measurements.points, measurements.photographs, measurements.pixels, measurements.sigma_px, strict=True
    ):
        k = by_name.get(photo, by_stem.get(Path(photo).stem))
        if k is None or name not in point_of:
            continue
        camera, orientation = photographs[k].camera, photographs[k].orientation
        px = stated if np.isfinite(stated) else control.measurement_sigma_px
        step = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        ray, right, down = camera.rays_from_image(pixel + step)[:, :2]
        point.append(point_of[name])
        centres.append(orientation.centre)
        rotations.append(orientation.object_from_camera)
        image.append(ray)
        sigma_px.append(px)
        sigma.append(px * np.sqrt(0.5 * (np.sum((right - ray) ** 2) + np.sum((down - ray) ** 2))))
    m = len(point)
    rays = Rays(
        np.array(point, np.int64),
        np.array(centres, np.float64).reshape(m, 3),
        np.array(rotations, np.float64).reshape(m, 3, 3),
        np.array(image, np.float64).reshape(m, 2),
        np.array(sigma, np.float64),
    )
    return rays, np.array(sigma_px, np.float64)


def _local_differences(project: Project, control: Control, points: Array) -> Array:
    """East, north, up at each point, intersection minus given."""
    given = control.tangent_xyz
    there = np.where(np.isfinite(given), given, points)
    difference = _enu(project, there) @ (points - there)[..., None]
    out: Array = np.where(np.isfinite(given), difference[..., 0], np.nan)
    return out


def _local_sigma(project: Project, found: Intersections) -> Array:
    enu = _enu(project, found.points)
    covariance = enu @ found.cofactors @ np.swapaxes(enu, -1, -2)
    sigma: Array = np.sqrt(np.maximum(np.einsum("kii->ki", covariance), 0.0))
    return sigma


def _enu(project: Project, points: Array) -> Array:
    """Rotations from tangent axes to east, north, up at points."""
    lon, lat, _ = np.moveaxis(project.tangent.geodetic_from_tangent(np.nan_to_num(points)), -1, 0)
    return np.swapaxes(project.tangent.rotation_tangent_from_enu(lon, lat), -1, -2)


def _image_rms(found: Intersections, rays: Rays, sigma_px: Array, good: NDArray[np.bool_]) -> float:
    used = good[rays.point]
    if not used.any():
        return float("nan")
    pixels = found.residuals[used] / rays.sigma[used, None] * sigma_px[used, None]
    return float(np.sqrt(np.mean(pixels**2)))


def _map_positions(project: Project, control: Control) -> Array:
    known = np.isfinite(control.tangent_xyz).all(axis=1)
    out = np.full((len(control.names), 2), np.nan)
    out[known] = map_from_tangent(project.tangent, project.frame, control.tangent_xyz[known])[:, :2]
    return out
