"""What `stereomate orient` starts from, in one frame: photographs, positions, control, measurements."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.block.start_pairs import Approximation
from stereomate.errors import InputError, ProjectError
from stereomate.formats.image_points import ImageMeasurements, read_image_points
from stereomate.frames.attitude import AttitudeConvention, object_from_camera
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import tangent_from_map
from stereomate.project.inputs import PhotoProblem
from stereomate.project.loader import project_frame
from stereomate.project.meaning import resolve_adjusted
from stereomate.project.orient_control import Control, read_block_control
from stereomate.project.orient_photos import RawPhoto, RawPhotos, raw_photos
from stereomate.project.orient_stated import photographs_of_measurements
from stereomate.project.orient_whereabouts import check_control_place, far_positions
from stereomate.project.orientations import (
    GNSS_CRS,
    Reading,
    WrittenOrientations,
    height_system,
    read_orientations,
)
from stereomate.project.reading import read_project_file
from stereomate.project.schema import UNDECLARED, ProjectFile

Array = NDArray[np.float64]

_EXIF_SIGMA_M: Final = (3.0, 3.0, 5.0)
_TABLE_SIGMA_M: Final = (0.05, 0.05, 0.10)
_EXIF_ANGLES: Final = AttitudeConvention("rph", "local", "deg", "y_forward")


@dataclass(frozen=True, eq=False)
class Positions:
    """Projection centres known beforehand.

    Attributes
    ----------
    source : {"exif", "table", "none"}
    tangent : ndarray, shape (n, 3)
        NaN for photographs without.
    sigma_m : (float, float, float)
        East, north, up.
    attitudes : ndarray, shape (n, 3, 3)
        Object from camera; NaN for photographs without.
    attitude_sigma : (float, float, float) or None
        Radians; None: they only help to choose pairs.
    geographic : ndarray, shape (n, 3)
        Longitude, latitude (degrees), height as written.
    height_above_start_m : float or None
        Median height above the place of take-off that the photographs state.
    """

    source: Literal["exif", "table", "none"]
    tangent: Array
    sigma_m: tuple[float, float, float]
    attitudes: Array
    attitude_sigma: tuple[float, float, float] | None
    geographic: Array
    height_above_start_m: float | None = None


@dataclass(frozen=True, eq=False)
class OrientInputs:
    """Everything that is known of a block before its photographs are looked into.

    Attributes
    ----------
    path : Path
        The project file.
    file : ProjectFile
    frame : MapFrame
    tangent : TangentFrame or None
        None where nothing says where the block is: then the frame of the model is arbitrary.
    photos : tuple of RawPhoto
    positions : Positions
    ground : float or None
        Approximate height of the ground in the tangent frame.
    control : Control or None
    tie_points : ImageMeasurements or None
        Stated, instead of found.
    problems : tuple of PhotoProblem
    notes : tuple of str
    findings : tuple of str
        What a reader must know of them.
    """

    path: Path
    file: ProjectFile
    frame: MapFrame
    tangent: TangentFrame | None
    photos: tuple[RawPhoto, ...]
    positions: Positions
    ground: float | None
    control: Control | None
    tie_points: ImageMeasurements | None
    problems: tuple[PhotoProblem, ...]
    notes: tuple[str, ...]
    findings: tuple[str, ...] = ()

    @property
    def approximation(self) -> Approximation:
        """What helps to choose pairs."""
        return Approximation(self.positions.tangent, self.positions.attitudes, self.ground)


def read_orient_inputs(path: str | Path) -> OrientInputs:
    """Read a project that is to be oriented.

    Raises
    ------
    StereomateError
        One of its classes for each kind of wrong input; file, key, rule and value are named.
    """
    path = Path(path)
    file = read_project_file(path)
    frame = project_frame(file, path)
    frame.require_conformal()
    reading = Reading(path, "photos", path.parent, file.project.crs, frame.heights)
    notes = [f"heights: {frame.heights.description}"]
    wants_table = file.orient.positions == "auto" and bool(file.photos.orientation)
    written = read_orientations(file.photos, reading) if wants_table else None
    if written is not None:
        notes += written.notes
    named = {} if written is None else dict(zip(map(_stem, written.names), written.cameras, strict=True))
    raw, tie_points = _photographs(file, path, named)
    notes += raw.notes
    control = read_block_control(file, path, reading, [photo.path.name for photo in raw.photos])
    if control is not None:
        notes += control.notes
    findings: list[str] = []
    tangent, positions = _positions(file, path, reading, written, raw.photos, frame, control, notes, findings)
    if control is not None:
        assert file.control is not None  # where it comes from
        degrees = _degrees(tangent, positions)
        check_control_place(control.frame, control.xyz, degrees, path.parent / file.control.file)
    if control is not None and tangent is not None:
        control = control.placed(tangent, frame)
    ground = _ground(file, frame, tangent, positions, control)
    return OrientInputs(
        path, file, frame, tangent, raw.photos, positions, ground, control, tie_points,
        raw.problems, tuple(notes), tuple(findings),
    )  # fmt: skip


def _photographs(
    file: ProjectFile, path: Path, named: dict[str, str | None]
) -> tuple[RawPhotos, ImageMeasurements | None]:
    """The photographs of the files, or of the measurements where there are none, and stated tie points."""
    if not file.photos.files:
        return photographs_of_measurements(file, path, named)
    raw = raw_photos(file, path, named)
    if file.orient.tie_points is None:
        return raw, None
    sizes = {photo.path.name: photo.info.size for photo in raw.photos if photo.info is not None}
    return raw, read_image_points(path.parent / file.orient.tie_points, sizes.get)


def _stem(name: str) -> str:
    return Path(name.replace("\\", "/")).stem


def _positions(
    file: ProjectFile,
    path: Path,
    reading: Reading,
    written: WrittenOrientations | None,
    photos: tuple[RawPhoto, ...],
    frame: MapFrame,
    control: Control | None,
    notes: list[str],
    findings: list[str],
) -> tuple[TangentFrame | None, Positions]:
    n = len(photos)
    nothing = np.full((n, 3), np.nan)
    turns = np.full((n, 3, 3), np.nan)
    above = [p.tags.height_above_start for p in photos if p.tags.height_above_start is not None]
    height = float(np.median(above)) if above else None
    if written is not None:
        if file.photos.adjusted_in == "grid":
            true = resolve_adjusted(file, reading, written, np.arange(len(written.names)), None, notes)
            assert true is not None  # declared, else refused
            written = replace(written, positions=true.centres)
        return _of_table(file, written, photos, frame, height, notes, findings)
    if file.orient.positions != "none":
        geographic = np.array([_exif_position(photo) for photo in photos]).reshape(n, 3)
        far = far_positions(geographic[:, :2], [photo.path.name for photo in photos])
        findings += far.values()
        geographic[list(far)] = math.nan
        known = np.isfinite(geographic).all(axis=1)
        if known.any():
            return _of_exif(file, reading, photos, frame, geographic, height, notes)
        if file.orient.positions == "exif":
            raise ProjectError(
                "must find positions in the photographs", file=path, field="orient.positions", value="exif"
            )
    origin = file.project.tangent_origin
    tangent = None
    if origin is not None:
        tangent = TangentFrame.at_geodetic(frame.geodetic, *origin)
    elif control is not None:
        tangent = control.tangent(frame)
    if tangent is None:
        notes.append("nothing says where the block is: positions and control points are missing")
    return tangent, Positions("none", nothing, _TABLE_SIGMA_M, turns, None, nothing, height)


def _of_table(
    file: ProjectFile,
    written: WrittenOrientations,
    photos: tuple[RawPhoto, ...],
    frame: MapFrame,
    height: float | None,
    notes: list[str],
    findings: list[str],
) -> tuple[TangentFrame, Positions]:
    geographic = np.array(written.frame.geodetic_from_map(written.positions))
    far = far_positions(geographic[:, :2], written.names)
    findings += far.values()
    geographic[list(far)] = math.nan
    tangent = _tangent(file, frame, geographic[np.isfinite(geographic).all(axis=1)])
    centres = tangent_from_map(tangent, written.frame, written.positions)
    turns = np.array(written.placed(tangent, centres))
    centres[list(far)], turns[list(far)] = math.nan, math.nan
    index = {_stem(name): k for k, name in enumerate(written.names)}
    rows = [index.get(photo.name, -1) for photo in photos]
    missing = [photo.name for photo, row in zip(photos, rows, strict=True) if row < 0]
    if len(missing) == len(photos):
        raise InputError(
            "names none of the photographs", file=written.source, field="filename", value=written.names[0]
        )
    if missing:
        notes.append(f"{len(missing)} photographs are not in {written.source.name}: {', '.join(missing[:5])}")
    taken = np.array(rows)
    absent = taken < 0

    def of_photos(values: Array) -> Array:
        result = np.array(values[taken])
        result[absent] = np.nan
        return result

    sigma = file.orient.attitude_sigma_deg
    from_exif = _copies_exif(of_photos(geographic), photos)
    if from_exif:
        notes.append(f"positions of {written.source.name} are those of the photographs' EXIF")
    default = _EXIF_SIGMA_M if from_exif else _TABLE_SIGMA_M
    return tangent, Positions(
        "exif" if from_exif else "table",
        of_photos(centres),
        file.orient.position_sigma_m or default,
        of_photos(turns),
        None if sigma is None else tuple(math.radians(v) for v in sigma),  # type: ignore[arg-type]
        of_photos(geographic),
        height,
    )


def _copies_exif(geographic: Array, photos: tuple[RawPhoto, ...]) -> bool:
    """Whether a table says no more than the photographs themselves: its accuracy is then theirs."""
    own = np.array([_exif_position(photo) for photo in photos])
    both = np.isfinite(own).all(axis=1) & np.isfinite(geographic).all(axis=1)
    return bool(both.any() and np.abs(own[both, :2] - geographic[both, :2]).max() < 2e-8)


def _exif_position(photo: RawPhoto) -> tuple[float, float, float]:
    tags = photo.tags
    if tags.longitude is None or tags.latitude is None or tags.altitude is None:
        return math.nan, math.nan, math.nan
    return tags.longitude, tags.latitude, tags.altitude


def _of_exif(
    file: ProjectFile,
    reading: Reading,
    photos: tuple[RawPhoto, ...],
    frame: MapFrame,
    geographic: Array,
    height: float | None,
    notes: list[str],
) -> tuple[TangentFrame, Positions]:
    heights = height_system(file.photos.heights, reading.heights, reading, "photos.heights")
    gnss = MapFrame(file.photos.crs or GNSS_CRS, heights)
    known = np.asarray(np.isfinite(geographic).all(axis=1))
    tangent = _tangent(file, frame, gnss.geodetic_from_map(geographic[known]))
    centres = np.full(geographic.shape, np.nan)
    centres[known] = tangent_from_map(tangent, gnss, geographic[known])
    turns = np.full((len(photos), 3, 3), np.nan)
    turned = [k for k, p in enumerate(photos) if p.tags.gimbal is not None and bool(known[k])]
    if turned:
        angles = np.array(
            [(g.roll_deg, g.pitch_deg, g.heading_deg) for k in turned if (g := photos[k].tags.gimbal)]
        )
        turns[turned] = object_from_camera(angles, _EXIF_ANGLES, tangent, centres[turned], None, None)
    if not known.all():
        notes.append(f"{int((~known).sum())} photographs have no position in their EXIF")
    return tangent, Positions(
        "exif", centres, file.orient.position_sigma_m or _EXIF_SIGMA_M, turns, None, geographic, height
    )


def _tangent(file: ProjectFile, frame: MapFrame, geographic: Array) -> TangentFrame:
    if file.project.tangent_origin is not None:
        return TangentFrame.at_geodetic(frame.geodetic, *file.project.tangent_origin)
    lon, lat, _ = geographic.mean(axis=0)
    # Rounded as in a run, so that both use the same frame.
    return TangentFrame.at_geodetic(frame.geodetic, round(float(lon), 3), round(float(lat), 3), 0.0)


def _degrees(tangent: TangentFrame | None, positions: Positions) -> Array:
    """Longitude and latitude of the positions (n, 2); NaN where not known."""
    degrees = np.full((len(positions.tangent), 2), math.nan)
    known = np.isfinite(positions.tangent).all(axis=1)
    if tangent is not None and known.any():
        degrees[known] = tangent.geodetic_from_tangent(positions.tangent[known])[:, :2]
    return degrees


def _ground(
    file: ProjectFile,
    frame: MapFrame,
    tangent: TangentFrame | None,
    positions: Positions,
    control: Control | None,
) -> float | None:
    """Approximate height of the ground in the tangent frame, for footprints."""
    if control is not None and control.is_placed:
        heights, flown = control.tangent_xyz[:, 2], positions.tangent[:, 2]
        if np.isfinite(heights).any():
            ground = float(np.nanmedian(heights))
            # Above the photographs it is none (feet for metres): the comparison of both will say so.
            if not np.isfinite(flown).any() or ground < np.nanmedian(flown):
                return ground
    known = np.isfinite(positions.tangent).all(axis=1)
    if tangent is None or not known.any():
        return None
    if file.terrain is not None and file.terrain.level is not None:
        x, y, z = positions.tangent[known].mean(axis=0)
        lon, lat, _ = tangent.geodetic_from_tangent(np.array([x, y, z]))
        place = frame.map_from_geodetic(np.array([lon, lat, 0.0]))
        place[2] = file.terrain.level
        return float(tangent_from_map(tangent, frame, place)[2])
    if positions.height_above_start_m is not None and positions.height_above_start_m > 0.0:
        return float(np.median(positions.tangent[known, 2])) - positions.height_above_start_m
    return None


def heights_are_verified(inputs: OrientInputs) -> bool:
    """Whether something besides the photographs' own altitudes says what their heights mean."""
    declared = inputs.file.photos.heights or inputs.file.project.heights
    return inputs.positions.source == "table" and declared != UNDECLARED
