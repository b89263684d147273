"""Positions and gimbal angles that drones wrote into their photographs, as orientations.

What they are worth: positions of code or RTK quality, angles to a degree or so. Angles are DJI's gimbal
angles; their traps (a roll of 180 at pitch -90) are resolved in `exif`. Altitudes say "above sea level" by
the standard and are ellipsoidal with most drones: the height system must be declared before they are brought
anywhere else.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from stereomate.errors import FormatError
from stereomate.formats.declared import Declared
from stereomate.formats.exif import read_camera_tags
from stereomate.formats.orientation_set import OrientationSet
from stereomate.frames.attitude import AttitudeConvention, axes_from_camera

_SUFFIXES: Final = {".jpg", ".jpeg", ".tif", ".tiff"}
_CONVENTION: Final = AttitudeConvention("rph", "local", "deg", "y_forward")


def read_exif_orientations(path: Path, declared: Declared) -> OrientationSet:
    """Orientations from the EXIF and XMP of the photographs in a folder.

    Parameters
    ----------
    path : Path
        Folder of JPEG or TIFF photographs, or one of them.
    declared : Declared
        `heights` of the altitudes; `crs` if the positions are not on WGS 84.

    Raises
    ------
    FormatError
        If there are no photographs, or one has no position or no gimbal angles: it is named.
    """
    files = sorted(f for f in path.iterdir() if f.suffix.lower() in _SUFFIXES) if path.is_dir() else [path]
    if not files:
        raise FormatError("holds no JPEG or TIFF photographs", file=path)
    place = declared.require_map(path, "EPSG:4326")
    if not place.is_geographic:
        raise FormatError("must be geographic: EXIF has longitude and latitude", file=path, field="crs")
    names, positions, angles = [], [], []
    turned = 0
    for file in files:
        tags = read_camera_tags(file)
        if tags.longitude is None or tags.latitude is None or tags.altitude is None:
            raise FormatError("has no GPS position with altitude", file=file)
        if tags.gimbal is None:
            raise FormatError("has no gimbal angles in its XMP", file=file)
        names.append(file.name)
        positions.append((tags.longitude, tags.latitude, tags.altitude))
        angles.append((tags.gimbal.roll_deg, tags.gimbal.pitch_deg, tags.gimbal.heading_deg))
        turned += tags.turned != 1
    notes = [
        (
            "angles are DJI's gimbal angles: heading from true north, body level at pitch -90; they are "
            "measurements of a degree or so, not an adjustment"
        ),
    ]
    if turned:
        notes.append(
            f"{turned} photographs have an EXIF Orientation other than 1: angles are of the upright image"
        )
    rotations = axes_from_camera(np.array(angles), _CONVENTION)
    return OrientationSet(tuple(names), np.array(positions), rotations, place, "local", notes=tuple(notes))
