"""A project's orientation rewritten for software that takes the grid as Cartesian; results brought back."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import FormatError, InputError, ProjectError, StorageError
from stereomate.formats.ign import GroundPoints, ImageObservations, write_mes
from stereomate.formats.orientation_table import MAP_COLUMNS, read_orientation_table
from stereomate.frames.adjusted import space_from_grid_centres
from stereomate.frames.attitude import AttitudeConvention, written_attitude
from stereomate.frames.checks import check_coordinates
from stereomate.frames.fixing import FixedBlock, ImageRays, Remedy, fixed_block
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.refraction import RefractionModel
from stereomate.frames.remedies import GridBlock, map_from_cartesian
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_map, tangent_from_map
from stereomate.project.control import read_control
from stereomate.project.loader import project_frame
from stereomate.project.observations import photo_cameras, principal_distance_px, project_observations
from stereomate.project.orientations import Reading, WrittenOrientations, height_system, read_orientations
from stereomate.project.reading import read_project_file
from stereomate.project.schema import ProjectFile

Array = NDArray[np.float64]

_RECORD = "fix.json"


@dataclass(frozen=True, eq=False)
class FixedProject:
    """What was written.

    Attributes
    ----------
    folder : Path
    files : tuple of Path
    fixed : FixedBlock
    words : tuple of str
        What the software has to do with it.
    """

    folder: Path
    files: tuple[Path, ...]
    fixed: FixedBlock
    words: tuple[str, ...]


def fix_project(
    path: Path,
    folder: Path,
    remedy: Remedy,
    *,
    per_image: bool = False,
    refraction: RefractionModel = "none",
) -> FixedProject:
    """Write orientation, camera factors and observations for software that works in the grid.

    Heights in all files are ellipsoidal. The orientation has to declare what it means: ``angles`` and
    ``adjusted_in``.

    Raises
    ------
    ProjectError
        If something is not declared, or a remedy needs observations that the project has not.
    StorageError
        If the folder cannot be written.
    """
    file = read_project_file(path)
    frame = project_frame(file, path)
    written = read_orientations(
        file.photos, Reading(path, "photos", path.parent, file.project.crs, frame.heights)
    )
    control_height = _control_height(file, path, frame)
    block = _true_block(file, path, written, control_height)
    notes: list[str] = []
    if file.observations is None and remedy == "M4":
        raise ProjectError("must be given: M4 corrects image observations", file=path, field="observations")
    names: tuple[str, ...] = ()
    if file.observations is None:
        none = np.zeros(0, dtype=np.int64)
        rays = ImageRays(none, none, np.zeros((0, 2)), 0)
    else:
        found = project_observations(file, path, written, notes)
        rays = ImageRays(found.point_of, found.photo_of, found.image, len(found.names))
        names = found.names
    fixed = fixed_block(block, rays, remedy, control_height, per_image=per_image, refraction=refraction)
    words = _words(fixed)
    if refraction != "none":
        words.append(f"refraction ({refraction}) is taken out of the observations: do not correct it again")
    cameras = photo_cameras(file, path, written, [])
    texts = {
        "orientation.csv": _orientation_csv(written, block, fixed, cameras),
        _RECORD: _record(block, fixed, words),
    }
    if file.control is not None:
        texts["control.csv"] = _control_csv(_control_in(file, path, frame, block.frame), fixed)
    files = _write(folder, texts, _observations(fixed, rays, names, written.names, cameras))
    return FixedProject(folder, files, fixed, tuple(words) + tuple(notes))


def _control_height(file: ProjectFile, path: Path, frame: MapFrame) -> float | None:
    """Mean ellipsoidal height of the control, if there is some."""
    if file.control is None:
        return None
    ellipsoidal = MapFrame(file.control.crs or file.project.crs, HeightSystem.ellipsoidal())
    return float(_control_in(file, path, frame, ellipsoidal).xyz[:, 2].mean())


def _control_in(file: ProjectFile, path: Path, frame: MapFrame, target: MapFrame) -> GroundPoints:
    """The control of a project in another map."""
    section = file.control
    if section is None:
        raise ProjectError("must be given", file=path, field="control")
    reading = Reading(path, "control", path.parent, file.project.crs, frame.heights)
    heights = height_system(section.heights, frame.heights, reading, "control.heights")
    control = MapFrame(section.crs or file.project.crs, heights)
    points = read_control(section, path.parent)
    check_coordinates(control, points.xyz, "control points", path.parent / section.file)
    return replace(points, xyz=map_from_map(target, control, points.xyz))


def _control_csv(points: GroundPoints, fixed: FixedBlock) -> str:
    """Control points with ellipsoidal heights, scaled where the centres' are."""
    scale = float(fixed.scale.mean()) if fixed.remedy == "M2" else 1.0
    rows = [["filename", "x", "y", "z"]]
    for name, (x, y, z) in zip(points.names, points.xyz.tolist(), strict=True):
        rows.append([name, f"{x:.5f}", f"{y:.5f}", f"{z * scale:.5f}"])
    return _csv(rows)


def _true_block(
    file: ProjectFile, path: Path, written: WrittenOrientations, control_height: float | None
) -> GridBlock:
    """True orientations, whatever the file meant."""
    if written.frame.is_geographic:
        raise ProjectError("must be coordinates of a map grid", file=path, field="photos.crs")
    meaning = file.photos.adjusted_in
    if meaning is None:
        hint = "stereomate georef audit tells it from tie and control points"
        raise ProjectError('must be "grid" or "space"', file=path, field="photos.adjusted_in", hint=hint)
    ellipsoidal = MapFrame(written.frame.crs, HeightSystem.ellipsoidal())
    positions = written.positions
    if meaning == "grid":
        reference = file.photos.grid_reference_height
        if reference is None and control_height is not None:
            middle = written.frame.geodetic_from_map(positions).mean(axis=0)
            reference = float(written.frame.map_from_geodetic([middle[0], middle[1], control_height])[2])
        if reference is None:
            rule = "must be given: there is no control whose mean height could stand in"
            raise ProjectError(rule, file=path, field="photos.grid_reference_height")
        positions = space_from_grid_centres(written.frame, positions, reference).centres
    centres_map = map_from_map(ellipsoidal, written.frame, positions)
    tangent = TangentFrame.at_map(ellipsoidal, np.append(centres_map[:, :2].mean(axis=0), 0.0))
    centres = tangent_from_map(tangent, ellipsoidal, centres_map)
    rotations = written.placed(tangent, centres)
    return GridBlock(tangent, ellipsoidal, centres, rotations, np.ones(len(centres)))


def _words(fixed: FixedBlock) -> list[str]:
    ppm = 1e6 * (float(fixed.scale.mean()) - 1.0)
    words = [
        f"heights are ellipsoidal; the scale tau_e at {fixed.ground_m:.1f} m is 1 {ppm:+.1f} ppm",
        "switch the software's own Earth curvature correction off: the observations carry it",
    ]
    if fixed.remedy == "M2":
        words.append(
            "heights of centres and of control points (control.csv) are multiplied by the scale: bring the "
            "results back with --back, which divides heights by it"
        )
    elif fixed.remedy == "M3":
        words.append("use the principal distances of orientation.csv, c / tau_e: for vertical photographs")
    else:
        words.append("orientation and camera are true; the observations hold all corrections")
    return words


def _orientation_csv(
    written: WrittenOrientations, block: GridBlock, fixed: FixedBlock, cameras: Sequence[Camera]
) -> str:
    """Names, grid positions, angles about grid axes in degrees, principal distances in pixels."""
    convention = AttitudeConvention("opk", "grid")
    angles = written_attitude(block.rotations, convention, block.tangent, block.centres, block.frame)
    centres = map_from_cartesian(block.frame, fixed.centres)
    rows = [["filename", "x", "y", "z", "omega", "phi", "kappa", "principal_distance_px"]]
    for k, name in enumerate(written.names):
        c = principal_distance_px(cameras[k]) * fixed.c_factor[k]
        position = [f"{value:.5f}" for value in centres[k]]
        rows.append([name, *position, *(f"{value:.9f}" for value in angles[k]), f"{c:.5f}"])
    return _csv(rows)


def _record(block: GridBlock, fixed: FixedBlock, words: list[str]) -> str:
    record = {
        "remedy": fixed.remedy,
        "crs": block.frame.crs,
        "heights": "ellipsoidal",
        "scale": float(fixed.scale.mean()),
        "ground_m": fixed.ground_m,
        "words": words,
    }
    return json.dumps(record, indent=2)


def _observations(
    fixed: FixedBlock,
    rays: ImageRays,
    points: Sequence[str],
    photographs: Sequence[str],
    cameras: Sequence[Camera],
) -> ImageObservations | None:
    """Corrected observations in pixels of the same camera; None without any."""
    good = np.isfinite(fixed.image).all(axis=1)
    if not good.any():
        return None
    pixels = np.full(fixed.image.shape, np.nan)
    directions = np.column_stack([fixed.image, -np.ones(len(fixed.image))])
    for k, camera in enumerate(cameras):
        rows = good & (rays.photo_of == k)
        pixels[rows] = camera.image_from_camera(directions[rows])[0]
    return ImageObservations(
        tuple(points[k] for k in rays.point_of[good]),
        tuple(photographs[k] for k in rays.photo_of[good]),
        pixels[good],
    )


def _write(folder: Path, texts: dict[str, str], observations: ImageObservations | None) -> tuple[Path, ...]:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise StorageError(f"{folder}: cannot be written ({error.strerror})") from error
    files = [folder / name for name in texts]
    if observations is not None:
        files.append(folder / "observations.mes")
        write_mes(files[-1], observations)
    return tuple(files)


def results_back(folder: Path, table: Path, out: Path) -> int:
    """Results of the software brought back to true heights.

    Parameters
    ----------
    folder : Path
        Where `fix_project` wrote.
    table : Path
        Points or orientations with a header: filename (or point), x, y, z, and whatever else.
    out : Path
        The same with true heights, as CSV.

    Returns
    -------
    int
        Number of rows.

    Raises
    ------
    FormatError, StorageError
    """
    record_path = folder / _RECORD
    try:
        record = json.loads(record_path.read_text(encoding="utf-8"))
        remedy, scale = str(record["remedy"]), float(record["scale"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FormatError("must be the record a fix wrote", file=record_path) from error
    if not 0.5 < scale < 2.0:
        raise InputError("must be a scale", file=record_path, field="scale", value=scale)
    found = read_orientation_table(table)
    if not found.has(MAP_COLUMNS):
        raise FormatError("must have the columns x, y, z", file=table, value=list(found.columns))
    numbers = [name for name in found.columns if name in found.rows[0].numbers]
    rows: list[list[str]] = [["filename", *numbers]]
    for row in found.rows:
        values = dict(row.numbers)
        if remedy == "M2":
            values["z"] /= scale
        rows.append([row.name, *(f"{values[name]:.9f}".rstrip("0").rstrip(".") for name in numbers)])
    try:
        out.write_text(_csv(rows), encoding="utf-8")
    except OSError as error:
        raise StorageError(f"{out}: cannot be written ({error.strerror})") from error
    return len(found.rows)


def _csv(rows: list[list[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
