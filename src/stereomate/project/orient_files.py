"""Files of an orientation: table, adjustment.json, Parquet tables, layer, oriented project file."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.formats.declared import Declared
from stereomate.formats.orientation_set import OrientationSet
from stereomate.formats.parquet import write_parquet
from stereomate.formats.tables import write_table
from stereomate.frames.transform import map_from_tangent
from stereomate.project.covariance_file import COVARIANCE, write_covariance
from stereomate.project.orient_adjust import Adjusted
from stereomate.project.orient_covariance import covariance_of
from stereomate.project.orient_inputs import OrientInputs
from stereomate.project.orient_layers import LAYERS, write_orient_layers
from stereomate.project.orient_observations import (
    OBSERVATIONS,
    WHOLE,
    write_observations,
    write_whole_covariance,
)
from stereomate.project.orient_photos import scan_pixels
from stereomate.project.orient_record import OrientedPhotos
from stereomate.project.orient_surface import SURFACE, write_tie_surface
from stereomate.project.schema import ProjectFile
from stereomate.project.toml_text import camera_section, toml_text
from stereomate.raster.files import write_whole

Array = NDArray[np.float64]

ORIENTATION: Final = "orientation.csv"
ADJUSTMENT: Final = "adjustment.json"
ORIENTED: Final = "oriented.toml"
TABLES: Final = (
    "photographs.parquet", "points.parquet", "image_points.parquet", "pairs.parquet", OBSERVATIONS,
)  # fmt: skip

_MEANINGS: Final = {
    "x": "map coordinate of the project (of the model without a datum)",
    "y": "map coordinate of the project (of the model without a datum)",
    "z": "height in the system of the project",
    "omega": "degrees, about local axes (east, north, up)",
    "phi": "degrees",
    "kappa": "degrees",
    "sx": "standard deviation along the tangent frame's x axis, metres",
    "sy": "standard deviation along the tangent frame's y axis, metres",
    "sz": "standard deviation along the tangent frame's z axis, metres",
    "cxy": "covariance of x and y, tangent frame, square metres",
    "cxz": "covariance of x and z",
    "cyz": "covariance of y and z",
    "col": "measured column, pixels from the outer corner of the first one",
    "row": "measured row",
    "residual_col": "observed minus computed, pixels",
    "residual_row": "observed minus computed, pixels",
    "redundancy_col": "redundancy number, 0 to 1",
    "redundancy_row": "redundancy number, 0 to 1",
    "standardized_col": "residual over its standard deviation",
    "standardized_row": "residual over its standard deviation",
    "detectable_col": "minimal detectable error, pixels",
    "detectable_row": "minimal detectable error, pixels",
    "point_shift_m": "motion of the point by its minimal detectable error, the larger axis",
    "photo_shift_m": "motion of the projection centre by its minimal detectable error, the larger axis",
    "used": "took part in the adjustment",
    "rays": "photographs that see it",
    "points": "tie points that both photographs show",
    "rms_px": "y-parallaxes that the orientation leaves, root mean square, pixels",
    "image_rms_px": "image residuals of a coordinate, root mean square, pixels",
}


def write_results(
    out: Path, inputs: OrientInputs, adjusted: Adjusted, photos: OrientedPhotos, record: dict[str, Any]
) -> list[Path]:
    """Write everything but the report and adjustment.json; what is found out here is added to `record`."""
    written = []
    surface = None
    if not inputs.file.has_ground:
        surface = write_tie_surface(out, inputs, adjusted)
    if surface is not None:
        record["findings"].append(surface[1])
        written.append(surface[0])
    if adjusted.has_datum:
        written += [_orientation(out / ORIENTATION, inputs, photos), out / ORIENTED]
        pairs = [(pair["left"], pair["right"]) for pair in record["y_parallaxes"]]
        covariance = covariance_of(adjusted, photos.names, pairs)
        (out / COVARIANCE).unlink(missing_ok=True)
        if covariance is not None and inputs.tangent is not None:
            written.append(out / COVARIANCE)
            write_covariance(out / COVARIANCE, covariance, inputs.tangent, out / ORIENTATION)
        project = oriented_project(inputs, adjusted, surface is not None, out / COVARIANCE in written)
        write_whole(out / ORIENTED, [project.encode()])
    written += _tables(out, inputs, adjusted, photos, record)
    if adjusted.has_datum:
        written.append(write_orient_layers(out / LAYERS, inputs, adjusted, photos, record))
    return written


def write_record(out: Path, record: dict[str, Any]) -> None:
    """Write adjustment.json."""
    write_whole(out / ADJUSTMENT, [(json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode()])


def _orientation(path: Path, inputs: OrientInputs, photos: OrientedPhotos) -> Path:
    orientations = OrientationSet(
        photos.names, photos.positions, photos.rotations, inputs.frame, "local", photos.cameras
    )
    write_table(path, orientations, Declared())
    return path


def _tables(
    out: Path, inputs: OrientInputs, adjusted: Adjusted, photos: OrientedPhotos, record: dict[str, Any]
) -> list[Path]:
    result = adjusted.result
    statistics = result.statistics
    n, m = len(photos.names), len(result.used)
    sigma = statistics.photo_sigma if statistics is not None else np.full((n, 6), math.nan)
    columns: dict[str, Any] = {"name": list(photos.names), "camera": list(photos.cameras)}
    columns |= dict(zip("xyz", photos.positions.T, strict=True))
    columns |= dict(zip(("omega", "phi", "kappa"), photos.opk_deg.T, strict=True))
    columns |= dict(zip(("sx", "sy", "sz"), sigma[:, :3].T, strict=True))
    degrees = np.degrees(sigma[:, 3:])
    columns |= dict(zip(("s_rotation_x", "s_rotation_y", "s_rotation_z"), degrees.T, strict=True))
    rms = [entry["image_rms_px"] for entry in record["photographs"]]
    columns["image_rms_px"] = np.array([math.nan if v is None else v for v in rms])
    write_parquet(out / TABLES[0], columns, _MEANINGS)
    points = result.points
    if adjusted.has_datum and inputs.tangent is not None:
        known = np.isfinite(points[:, 0])
        points = points.copy()
        points[known] = map_from_tangent(inputs.tangent, inputs.frame, points[known])
    spread = statistics.point_sigma if statistics is not None else np.full((len(points), 3), math.nan)
    image = result.network.image
    columns = {"name": list(result.network.points.names)}
    columns |= dict(zip("xyz", points.T, strict=True))
    columns |= dict(zip(("sx", "sy", "sz"), spread.T, strict=True))
    cofactors = np.full((len(points), 3, 3), math.nan)
    if statistics is not None:
        cofactors = statistics.scale**2 * statistics.cofactors.points
    columns |= {f"c{a}{b}": cofactors[:, "xyz".index(a), "xyz".index(b)] for a, b in ("xy", "xz", "yz")}
    columns["rays"] = np.bincount(image.point[result.used], minlength=len(points))
    write_parquet(out / TABLES[1], columns, _MEANINGS)
    columns = {
        "point": [result.network.points.names[k] for k in image.point.tolist()],
        "photograph": [photos.names[k] for k in image.photo.tolist()],
        "used": result.used,
    }
    pixels = scan_pixels(inputs.photos, adjusted.assembled.photos[image.photo], image.xy)
    columns |= {"col": pixels[:, 0], "row": pixels[:, 1], "sigma_px": image.sigma[:, 0]}
    nothing = np.full((m, 2), math.nan)
    pairs = {
        "residual": result.residuals,
        "redundancy": nothing if statistics is None else statistics.image.redundancy,
        "standardized": nothing if statistics is None else statistics.image.standardized,
        "detectable": nothing if statistics is None else statistics.image.minimal_detectable,
    }
    for name, values in pairs.items():
        columns[f"{name}_col"], columns[f"{name}_row"] = values.T
    columns["point_shift_m"] = (nothing if statistics is None else statistics.on_point).max(axis=1)
    columns["photo_shift_m"] = (nothing if statistics is None else statistics.on_photo).max(axis=1)
    write_parquet(out / TABLES[2], columns, _MEANINGS)
    parallaxes = record["y_parallaxes"]
    columns = {key: [pair[key] for pair in parallaxes] for key in ("left", "right")}
    columns["points"] = np.array([pair["points"] for pair in parallaxes], dtype=np.int64)
    columns["rms_px"] = np.array([pair["rms_px"] for pair in parallaxes], dtype=np.float64)
    write_parquet(out / TABLES[3], columns, _MEANINGS)
    write_observations(out / OBSERVATIONS, result)
    (out / WHOLE).unlink(missing_ok=True)
    whole = []
    if inputs.file.orient.full_covariance:
        whole.append(write_whole_covariance(out / WHOLE, result))
    return [out / name for name in TABLES] + whole


def oriented_project(
    inputs: OrientInputs, adjusted: Adjusted, own_surface: bool, has_covariance: bool
) -> str:
    """A project file of the oriented photographs: `stereomate run` goes on from it.

    Everything that the first project file says of terrain and products is kept; paths are absolute.
    """
    document = absolute_document(inputs.file, inputs.path.parent)
    for section in ("orient", "control", "observations"):
        document.pop(section, None)
    document["project"].setdefault("name", inputs.path.stem)
    if inputs.tangent is not None:
        t = inputs.tangent
        document["project"]["tangent_origin"] = [t.longitude_deg, t.latitude_deg, t.height_m]
    there = [p for k in adjusted.oriented if (p := inputs.photos[k]).info is not None]
    document["photos"] = {"files": [str(photo.path.resolve()) for photo in there]} if there else {}
    document["photos"] |= {"orientation": ORIENTATION, "angles": "local", "adjusted_in": "space"}
    if has_covariance:
        document["photos"]["orientation_covariance"] = COVARIANCE
    if own_surface:
        document["terrain"] = {"file": SURFACE}
    document["camera"] = [
        camera_section(camera) | _film_part(document, camera) for camera in adjusted.result.cameras
    ]
    return (
        "# Written by stereomate orient: the oriented photographs, their calibrated cameras, and what\n"
        f"# {inputs.path.name} says of terrain and products. stereomate run goes on from here.\n\n"
        + toml_text(document)
    )


def _film_part(document: dict[str, Any], camera: Camera) -> dict[str, Any]:
    """The fiducial marks of a film camera: each scan keeps its own interior orientation."""
    sections = {section["name"]: section for section in document.get("camera", ())}
    fiducials = sections.get(camera.name, {}).get("fiducials")
    return {} if fiducials is None else {"fiducials": fiducials}


def absolute_document(file: ProjectFile, folder: Path) -> dict[str, Any]:
    """What a project file in a folder states, its paths absolute: to be written into another folder."""
    document = file.model_dump(mode="json", exclude_unset=True)
    for section, keys in _PATHS.items():
        for key in keys:
            value = (document.get(section) or {}).get(key)
            if isinstance(value, str) and value:
                document[section][key] = _absolute(folder, value)
            elif isinstance(value, list):
                document[section][key] = [_absolute(folder, v) for v in value]
    for section in ("project", "photos", "terrain", "control"):
        heights = (document.get(section) or {}).get("heights")
        if isinstance(heights, str) and (folder / heights).is_file():
            document[section]["heights"] = str((folder / heights).resolve())
    for camera in document.get("camera", ()):
        film = camera.get("fiducials") or {}
        if film.get("measured"):
            film["measured"] = _absolute(folder, film["measured"])
        for mark in (film.get("template"), *(film.get("templates") or {}).values()):
            if mark is not None and mark.get("file"):
                mark["file"] = _absolute(folder, mark["file"])
    compare = document["photos"].get("compare")
    if compare is not None:
        compare["orientation"] = _absolute(folder, compare["orientation"])
    return document


_PATHS: Final = {
    "photos": ("files", "orientation", "orientation_covariance"),
    "control": ("file", "measurements"),
    "observations": ("files", "points"),
    "orient": ("tie_points",),
    "terrain": ("file", "water"),
    "products": ("area", "sheets", "breaklines", "seam_file", "law_table"),
}


def _absolute(folder: Path, text: str) -> str:
    return text if Path(text).is_absolute() else str(folder.resolve() / text)
