"""Project files as text: documents of tables and plain values, and the section that describes a camera."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np

from stereomate.camera.distortion import BrownDistortion, FisheyeDistortion, NoDistortion, OpenCVDistortion
from stereomate.camera.model import Camera


def camera_section(camera: Camera) -> dict[str, Any]:
    """A ``[[camera]]`` section of a calibrated camera."""
    (a, b, _), (d, e, _) = camera.pixel_from_photo
    section: dict[str, Any] = {"name": camera.name, "size_px": list(camera.size_px)}
    section["principal_distance_mm"] = camera.principal_distance_mm
    columns, rows = camera.size_px
    turned = abs(b) > abs(a)
    pitch = [1.0 / math.hypot(a, d), 1.0 / math.hypot(b, e)]
    section["pixel_pitch_mm"] = pitch[::-1] if turned else pitch
    x, y = camera.principal_point_mm
    section["principal_point_mm"] = [x, y]
    for rotation in (0, 90, 180, 270):
        for mirrored in (False, True):
            again = Camera.from_pixel_pitch(
                camera.name,
                (columns, rows),
                1.0,
                (section["pixel_pitch_mm"][0], section["pixel_pitch_mm"][1]),
                rotation=rotation,
                mirrored=mirrored,
            )
            if np.allclose(again.pixel_from_photo, camera.pixel_from_photo, rtol=1e-12, atol=1e-9):
                section |= {"rotation": rotation} if rotation else {}
                section |= {"mirrored": True} if mirrored else {}
    distortion = _distortion_section(camera)
    if distortion:
        section["distortion"] = distortion
    if camera.deformation is not None:
        section["ebner"] = dataclasses.asdict(camera.deformation)
    return section


def _distortion_section(camera: Camera) -> dict[str, Any]:
    d = camera.distortion
    if isinstance(d, NoDistortion):
        return {}
    terms = {name: float(getattr(d, name)) for name in d.coefficient_names if getattr(d, name) != 0.0}
    if isinstance(d, FisheyeDistortion):
        return {"model": "fisheye", **terms}
    if isinstance(d, OpenCVDistortion):
        return {"model": "opencv", **terms}
    assert isinstance(d, BrownDistortion)  # the four models there are
    section: dict[str, Any] = {
        "model": "brown", "convention": d.convention, "direction": d.direction, "units": d.units,
    }  # fmt: skip
    if d.symmetry_mm is not None:
        section["point_of_symmetry_mm"] = list(d.symmetry_mm)
    return {**section, **terms}


def toml_text(document: dict[str, Any]) -> str:
    """A TOML document of tables, lists of tables and plain values."""
    parts = []
    for name, value in document.items():
        if value is None:
            continue
        tables = value if isinstance(value, list) else [value]
        head = f"[[{name}]]" if isinstance(value, list) else f"[{name}]"
        for table in tables:
            lines = [f"{key} = {_toml(item)}" for key, item in table.items() if item is not None]
            parts.append("\n".join([head, *lines]))
    return "\n\n".join(parts) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_toml(v)}" for k, v in value.items() if v is not None) + " }"
    return "[" + ", ".join(_toml(v) for v in value) + "]"
