"""`stereomate relative --points`: the orientation of measured points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stereomate.cli.output import plain, print_json
from stereomate.cli.relative_print import print_counts, print_orientation, print_points

if TYPE_CHECKING:
    from stereomate.camera.model import Camera
    from stereomate.relative.measured_orientation import MeasuredOrientation
    from stereomate.relative.orientation import RelativeOptions


@dataclass(frozen=True)
class PointsInput:
    """A table of points, what calibrates it, and how it is to be adjusted."""

    file: Path
    camera: Path | None
    principal_distance: str | None
    sigma: float | None
    equal_weights: bool
    seed: int


def orient_points(given: PointsInput, output: Path | None, figures: Path | None, json: bool) -> None:
    """Orient, write what was asked for, print; NotDeterminedError where the points do not determine it."""
    from stereomate.errors import InputError, NotDeterminedError
    from stereomate.relative.measured_orientation import orient_measured
    from stereomate.relative.measured_points import correspondences_of_table
    from stereomate.relative.point_table import load_point_table

    if given.sigma is not None and not 0.0 < given.sigma < float("inf"):
        raise InputError("must be positive", field="--sigma", value=given.sigma)
    calibration = _calibration(given)
    points = load_point_table(given.file, ("image", "pixels"))
    correspondences = correspondences_of_table(points, given.file, calibration, given.sigma)
    result = orient_measured(correspondences, points.names, _options(given))
    if output is not None:
        _write(output, result)
    if figures is not None and result.orientation is not None:
        _write_figures(figures, result, given.file.name)
    if json:
        print_json(_record(result, points=False))
    else:
        _print(result, given.file.name)
    if not result.determined:
        raise NotDeterminedError(f"{given.file} gives no orientation: {'; '.join(result.reasons)}")


def _calibration(given: PointsInput) -> tuple[Camera, Camera] | tuple[float, float]:
    from stereomate.errors import InputError

    if (given.camera is None) == (given.principal_distance is None):
        raise InputError(
            "must be given, one of the two: the first for pixels, the other for millimetres",
            field="--camera or --principal-distance",
        )
    if given.camera is not None:
        from stereomate.cli.relative import cameras_of_pair

        return cameras_of_pair(given.camera)
    text = given.principal_distance or ""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(0.0 < value < float("inf") for value in values):
        raise InputError(
            "must be millimetres, one number or LEFT,RIGHT", field="--principal-distance", value=text
        )
    return values[0], values[-1]


def _options(given: PointsInput) -> RelativeOptions:
    from stereomate.relative.coplanarity import CoplanarityOptions
    from stereomate.relative.orientation import RelativeOptions
    from stereomate.relative.robust import RobustOptions

    adjustment = CoplanarityOptions(conditions="equal" if given.equal_weights else "propagated")
    return RelativeOptions(search=RobustOptions(seed=given.seed), adjustment=adjustment)


def _record(result: MeasuredOrientation, points: bool = True) -> dict[str, Any]:
    from stereomate.relative.summary import table_record

    return table_record(result.names, result.orientation, result.reasons, result.notes, points)


def _write(path: Path, result: MeasuredOrientation) -> None:
    import json

    from stereomate.raster.files import write_whole

    write_whole(path, [json.dumps(plain(_record(result)), ensure_ascii=False).encode() + b"\n"])


def _write_figures(folder: Path, result: MeasuredOrientation, title: str) -> None:
    from stereomate.cli.relative import figure_folder
    from stereomate.report.overcorrection_style import save_figure
    from stereomate.report.relative import point_picture, six_point_picture

    assert result.orientation is not None
    figure_folder(folder)
    save_figure(
        point_picture(result.orientation, result.names, title, result.determined), folder / "y-parallaxes.png"
    )
    if result.determined:
        save_figure(six_point_picture(result.orientation, title), folder / "six-points.png")


def _print(result: MeasuredOrientation, title: str) -> None:
    import numpy as np

    orientation = result.orientation
    counts = {"points": len(result.names)}
    if orientation is not None:
        counts["points used"] = int(np.count_nonzero(orientation.used))
    print_counts(title, counts, result.notes)
    if orientation is not None and result.determined:
        print_orientation(orientation)
        print_points(orientation, result.names)
