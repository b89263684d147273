"""orientation_covariance.json: what an adjustment knows of the accuracy of its orientations."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any, Final

from stereomate.coverage.covariance import OrientationCovariance
from stereomate.errors import FormatError
from stereomate.forms import ORIENTATION_COVARIANCE
from stereomate.frames.tangent import TangentFrame
from stereomate.project.inputs import file_digest
from stereomate.raster.files import write_whole

COVARIANCE: Final = "orientation_covariance.json"
_UNKNOWNS: Final = (
    "of each photograph: centre (X, Y, Z, metres), then a small rotation (radians) with true rotation = "
    "exp(theta) times the written one; along and about the axes of the tangent frame. Photographs: upper "
    "triangle, row after row; pairs: first by second, row after row"
)


def write_covariance(
    path: Path, covariance: OrientationCovariance, tangent: TangentFrame, orientation: Path
) -> None:
    """Write the file; it names the orientations that it belongs to by their hash."""
    document = {
        "format": ORIENTATION_COVARIANCE.version,
        "kind": "covariances of orientations",
        "unknowns": _UNKNOWNS,
        "tangent": dataclasses.asdict(tangent),
        "orientation_sha256": file_digest(orientation),
        **covariance.as_record(),
    }
    write_whole(path, [(json.dumps(document, ensure_ascii=False) + "\n").encode()])


def read_covariance(path: Path, tangent: TangentFrame, orientation: Path) -> OrientationCovariance:
    """Covariances along the axes of a tangent frame.

    Raises
    ------
    FormatError
        If it is no such file, newer than this stereomate reads, or belongs to other orientations.
    """
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FormatError("does not exist", file=path) from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FormatError(f"is not JSON ({error})", file=path) from error
    if not isinstance(document, dict):
        raise FormatError("must hold covariances of orientations", file=path)
    document = ORIENTATION_COVARIANCE.migrated(document, path)
    try:
        found = OrientationCovariance.from_record(document)
        source, belongs = TangentFrame(**document["tangent"]), document["orientation_sha256"]
    except FormatError as error:
        raise FormatError(error.rule, file=path, field=error.field) from error
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"lacks or garbles a value ({error})", file=path) from error
    if belongs != file_digest(orientation):
        raise FormatError(
            f"belongs to other orientations than {orientation.name}",
            file=path,
            field="orientation_sha256",
            value=belongs,
            hint="leave photos.orientation_covariance out for orientations that were changed",
        )
    return found.in_frame(tangent, source)
