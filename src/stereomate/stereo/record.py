"""The domain values of a product as plain records for ``stereo.json``, and back.

Only what defines the product: numbers in full precision, file names relative to the folder of the file
where they lie below it or beside it.
"""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from stereomate.camera.distortion import (
    BrownDistortion,
    Distortion,
    EbnerDeformation,
    FisheyeDistortion,
    NoDistortion,
    OpenCVDistortion,
)
from stereomate.camera.model import Camera
from stereomate.coverage.survey import Photograph
from stereomate.errors import FormatError
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.orientation import ExteriorOrientation
from stereomate.frames.tangent import TangentFrame
from stereomate.rectify.grid import ProductGrid
from stereomate.rectify.layout import StereoModel
from stereomate.terrain.breaklines import BurnedSurface, SurfaceFeature
from stereomate.terrain.model import HeightModel
from stereomate.terrain.source import FileSource

Record = dict[str, Any]

_DISTORTIONS: dict[str, type[Any]] = {
    "none": NoDistortion,
    "brown": BrownDistortion,
    "opencv": OpenCVDistortion,
    "fisheye": FisheyeDistortion,
}


def relative_path(path: Path | None, folder: Path) -> str | None:
    """`path` as written in a file in `folder`."""
    if path is None:
        return None
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


def path_from_record(text: str | None, folder: Path) -> Path | None:
    """The path that `relative_path` wrote."""
    return None if text is None else Path(os.path.normpath(folder / text))


def height_system_record(heights: HeightSystem, folder: Path) -> Record:
    """Kind, reference and unit of a height system."""
    record = dataclasses.asdict(heights)
    if heights.kind == "grid_file":
        record["reference"] = relative_path(Path(heights.reference), folder)
    return record


def height_system_from_record(record: Record, folder: Path) -> HeightSystem:
    """Inverse of `height_system_record`."""
    if record["kind"] == "grid_file":
        return HeightSystem.grid_file(str(path_from_record(record["reference"], folder)), record["unit_m"])
    return HeightSystem(**record)


def frame_record(frame: MapFrame, folder: Path) -> Record:
    """CRS and height system."""
    return {"crs": frame.crs, "heights": height_system_record(frame.heights, folder)}


def frame_from_record(record: Record, folder: Path) -> MapFrame:
    """Inverse of `frame_record`."""
    return MapFrame(record["crs"], height_system_from_record(record["heights"], folder))


def camera_record(camera: Camera) -> Record:
    """All that makes a camera."""
    distortion = dataclasses.asdict(camera.distortion)
    kind = next(name for name, cls in _DISTORTIONS.items() if type(camera.distortion) is cls)
    return {
        "name": camera.name,
        "size_px": list(camera.size_px),
        "principal_distance_mm": camera.principal_distance_mm,
        "principal_point_mm": list(camera.principal_point_mm),
        "pixel_from_photo": [list(row) for row in camera.pixel_from_photo],
        "distortion": {"model": kind, **distortion},
        **({} if camera.format_mm is None else {"format_mm": list(camera.format_mm)}),
        **_film_record(camera),
    }


def _film_record(camera: Camera) -> Record:
    """What only film has."""
    record: Record = {}
    if camera.projective_per_mm != (0.0, 0.0):
        record["projective_per_mm"] = list(camera.projective_per_mm)
    if camera.deformation is not None:
        record["deformation"] = {"model": "ebner", **dataclasses.asdict(camera.deformation)}
    return record


def camera_from_record(record: Record) -> Camera:
    """Inverse of `camera_record`."""
    distortion = dict(record["distortion"])
    kind = distortion.pop("model")
    if kind not in _DISTORTIONS:
        raise FormatError("must be a known distortion model", field="distortion.model", value=kind)
    arguments = {key: tuple(v) if isinstance(v, list) else v for key, v in distortion.items()}
    built: Distortion = _DISTORTIONS[kind](**arguments)
    matrix = record["pixel_from_photo"]
    return Camera(
        record["name"],
        (record["size_px"][0], record["size_px"][1]),
        record["principal_distance_mm"],
        (record["principal_point_mm"][0], record["principal_point_mm"][1]),
        (tuple(matrix[0]), tuple(matrix[1])),
        built,
        tuple(record["format_mm"]) if "format_mm" in record else None,
        tuple(record.get("projective_per_mm", (0.0, 0.0))),
        _deformation(record.get("deformation")),
    )


def _deformation(record: Record | None) -> EbnerDeformation | None:
    if record is None:
        return None
    values = dict(record)
    if values.pop("model") != "ebner":
        raise FormatError("must be a known model", field="deformation.model", value=record["model"])
    return EbnerDeformation(**values)


def photograph_record(photograph: Photograph, folder: Path) -> Record:
    """Name, file, camera's name, orientation (tangent frame), and time of exposure where it is known."""
    time = {} if photograph.time is None else {"time_s": photograph.time}
    return {
        "name": photograph.name,
        "file": relative_path(photograph.path, folder),
        "camera": photograph.camera.name,
        "centre": list(photograph.orientation.centre),
        "object_from_camera": photograph.orientation.object_from_camera.tolist(),
        **time,
    }


def photograph_from_record(record: Record, cameras: dict[str, Camera], folder: Path) -> Photograph:
    """Inverse of `photograph_record`."""
    x, y, z = record["centre"]
    orientation = ExteriorOrientation((x, y, z), np.array(record["object_from_camera"]))
    return Photograph(
        name=record["name"],
        path=path_from_record(record["file"], folder),
        camera=cameras[record["camera"]],
        orientation=orientation,
        time=record.get("time_s"),
    )


def tangent_record(tangent: TangentFrame) -> Record:
    """Origin and ellipsoid of the tangent frame."""
    return dataclasses.asdict(tangent)


def tangent_from_record(record: Record) -> TangentFrame:
    """Inverse of `tangent_record`."""
    return TangentFrame(**record)


def grid_record(grid: ProductGrid) -> Record:
    """The product grid, with its affine transform for other programs."""
    return {
        "u0": grid.u0,
        "v0": grid.v0,
        "gsd": grid.gsd,
        "size": list(grid.size),
        "rotation_rad": grid.rotation,
        "affine": list(grid.affine),
    }


def grid_from_record(record: Record) -> ProductGrid:
    """Inverse of `grid_record`."""
    size = (int(record["size"][0]), int(record["size"][1]))
    return ProductGrid(record["u0"], record["v0"], record["gsd"], size, record["rotation_rad"])


def model_record(model: StereoModel) -> Record:
    """A model of the product."""
    return dataclasses.asdict(model)


def model_from_record(record: Record) -> StereoModel:
    """Inverse of `model_record`."""
    values = dict(record)
    # JSON has no NaN: what a single photograph does not have is written as null.
    if values["height_above_ground_m"] is None:
        values["height_above_ground_m"] = math.nan
    return StereoModel(**values)


def height_model_record(model: HeightModel, folder: Path) -> Record:
    """The height model: its file, how its numbers are read, and what is burned in.

    Raises
    ------
    FormatError
        If it is not a file: nobody could read it again.
    """
    if not isinstance(model.source, FileSource):
        raise FormatError("must be a file to be recorded", field="height_model", value=model.name)
    features = model.features if isinstance(model, BurnedSurface) else ()
    return {
        "file": relative_path(model.source.path, folder),
        "sha256": model.content_hash,
        "frame": frame_record(model.frame, folder),
        "affine": list(model.affine),
        "nodata": model.source.nodata,
        "factor": model.source.factor,
        "features": [
            {
                "geometry": shapely.to_wkt(f.geometry, rounding_precision=-1, output_dimension=3),
                "rule": f.rule,
                "height": f.height,
                "width": f.width,
            }
            for f in features
        ],
    }


def height_model_from_record(record: Record, folder: Path) -> HeightModel:
    """Inverse of `height_model_record`; the file is opened when heights are asked for."""
    path = path_from_record(record["file"], folder)
    if path is None:
        raise FormatError("must name a file", file=folder, field="height_model.file")
    source = FileSource(path, record["nodata"], record["factor"])
    a, b, c, d, e, f = record["affine"]
    model = HeightModel(source, frame_from_record(record["frame"], folder), (a, b, c, d, e, f), path)
    if not record["features"]:
        return model
    features = [
        SurfaceFeature(shapely.from_wkt(r["geometry"]), r["rule"], r["height"], r["width"])
        for r in record["features"]
    ]
    return BurnedSurface.of(model, features)
