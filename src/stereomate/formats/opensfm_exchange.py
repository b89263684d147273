"""OpenSfM reconstructions as orientation sets: which frame they are in, and writing them.

`opensfm` says what a ``reconstruction.json`` is and how its two meanings are told apart.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import FormatError
from stereomate.formats.declared import Declared
from stereomate.formats.lens import lens_of
from stereomate.formats.opensfm import frame_of, read_opensfm, reference_in_map, tangent_at
from stereomate.formats.orientation_set import OrientationSet
from stereomate.formats.text_files import write_text
from stereomate.frames.crs import WGS84, datum_note, geodetic_of, same_datum
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_map
from stereomate.geometry.rotations import quaternion_from_rotation

Array = NDArray[np.float64]

_FLIP: Final = np.diag([1.0, -1.0, -1.0])


def read_opensfm_orientations(path: Path, declared: Declared) -> OrientationSet:
    """Read a reconstruction in the frame it is in.

    Parameters
    ----------
    path : Path
    declared : Declared
        `opensfm_frame`, or a projected `crs`: the measured positions then tell whether the centres are in it.

    Raises
    ------
    FormatError
        If the frame is neither declared nor told by the data.
    """
    model = read_opensfm(path)
    frame, notes = declared.opensfm_frame, []
    if frame is None:
        if declared.crs is None:
            raise FormatError(
                "does not say which frame its centres are in",
                file=path,
                field="opensfm_frame",
                hint="declare one of: topocentric (OpenSfM itself: east north up about reference_lla); "
                "projected with the crs (georeferenced by OpenDroneMap: its UTM zone); or only the crs, and "
                "the measured positions decide",
            )
        evidence = frame_of(model, declared.require_map(path))
        frame = evidence.frame
        notes.append(f"{path.name}: {evidence.sentence}")
    centres = np.array([shot.centre for shot in model.shots])
    rotations = np.array([shot.object_from_camera for shot in model.shots])
    names = tuple(shot.name for shot in model.shots)
    cameras = tuple(shot.camera for shot in model.shots)
    if frame == "topocentric":
        place = tangent_at(model.reference)
        notes.append(f"{path.name}: the altitude of reference_lla is taken as ellipsoidal, on WGS 84")
        return OrientationSet(
            names, centres, rotations, place, "tangent", cameras, model.cameras, tuple(notes)
        )
    grid = declared.require_map(path)
    grid.require_conformal()
    x, y = reference_in_map(model.reference, grid)
    positions = centres + np.array([x, y, model.reference[2]]) + declared.offset
    notes.append(f"{path.name}: centres are projected coordinates minus those of reference_lla")
    return OrientationSet(
        names, positions, rotations, grid, "grid_east_north", cameras, model.cameras, tuple(notes)
    )


def write_opensfm(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write a reconstruction: topocentric from a tangent frame, projected from a map; returns notes.

    Raises
    ------
    FormatError
        If a photograph has no camera, one cannot be written, or the frame is neither on WGS 84.
    """
    values = {**orientations.camera_values, **declared.cameras}
    used = dict.fromkeys(orientations.cameras)
    only = next(iter(values)) if len(values) == 1 else None
    names = {name: name or only for name in used}
    for name, key in names.items():
        if key not in values:
            rule = "needs the camera of every photograph"
            raise FormatError(rule, file=path, field="camera", value=name, hint="declare cameras")
    reference, centres, words = _reference(path, orientations)
    inverse = _FLIP @ np.swapaxes(orientations.rotations, -1, -2)
    translations = -np.einsum("nij,nj->ni", inverse, centres)
    vectors = _vectors(inverse)
    shots = {
        name: {
            "rotation": list(vector),
            "translation": list(translation),
            "camera": names[camera],
        }
        for name, camera, vector, translation in zip(
            orientations.names, orientations.cameras, vectors.tolist(), translations.tolist(), strict=True
        )
    }
    lon, lat, altitude = reference
    document = [
        {
            "cameras": {key: _camera(values[key]) for key in dict.fromkeys(k for k in names.values() if k)},
            "shots": shots,
            "points": {},
            "reference_lla": {"latitude": lat, "longitude": lon, "altitude": altitude},
        }
    ]
    write_text(path, json.dumps(document, indent=4, ensure_ascii=False) + "\n")
    return (words,)


def _reference(path: Path, orientations: OrientationSet) -> tuple[tuple[float, float, float], Array, str]:
    place = orientations.place
    datum = geodetic_of(WGS84)
    on_wgs84 = place.geodetic is not None and same_datum(place.geodetic, datum)
    if isinstance(place, TangentFrame) and on_wgs84:
        reference = (place.longitude_deg, place.latitude_deg, place.height_m)
        return reference, np.array(orientations.positions), "centres are topocentric about reference_lla"
    if isinstance(place, MapFrame) and not place.is_geographic:
        plain = MapFrame(place.crs, HeightSystem.undeclared())
        middle = orientations.positions.mean(axis=0)
        lon, lat, _ = map_from_map(MapFrame(WGS84, HeightSystem.undeclared()), plain, middle)
        reference = (round(float(lon), 6), round(float(lat), 6), 0.0)
        x, y = reference_in_map(reference, place)
        note = datum_note(datum, place.geodetic)
        words = "centres are projected coordinates minus those of reference_lla, with axes of the grid"
        return (
            reference,
            orientations.positions - np.array([x, y, 0.0]),
            words + (f"; {note}" if note else ""),
        )
    rule = "holds topocentric coordinates on WGS 84, or projected ones"
    raise FormatError(rule, file=path, field="crs", hint="declare an origin, or a projected CRS")


def _vectors(rotations: Array) -> Array:
    """Angle-axis vectors of rotations (n, 3, 3)."""
    q = quaternion_from_rotation(rotations)
    length = np.linalg.norm(q[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(length, q[:, 0])
    factor = np.where(length > 1e-12, angle / np.where(length > 1e-12, length, 1.0), 2.0)
    vectors: Array = factor[:, None] * q[:, 1:]
    return vectors


def _camera(camera: Camera) -> dict[str, Any]:
    lens = lens_of(camera)
    if lens.shear or (lens.kind != "fisheye" and lens.radial[3]):
        raise FormatError("has shear or k4, which OpenSfM cannot hold", field=f"camera {camera.name!r}")
    width, height = lens.size_px
    longer = float(max(width, height))
    k1, k2, k3, k4 = lens.radial
    record: dict[str, Any] = {
        "projection_type": "fisheye_opencv" if lens.kind == "fisheye" else "brown",
        "width": width,
        "height": height,
        "focal_x": lens.fx / longer,
        "focal_y": lens.fy / longer,
        "c_x": (lens.cx - width / 2.0) / longer,
        "c_y": (lens.cy - height / 2.0) / longer,
        "k1": k1,
        "k2": k2,
        "k3": k3,
    }
    more = {"k4": k4} if lens.kind == "fisheye" else {"p1": lens.p1, "p2": lens.p2}
    return {**record, **more}
