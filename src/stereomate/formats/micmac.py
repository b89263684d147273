"""MicMac orientations: a folder ``Ori-...`` with one ``Orientation-NAME.xml`` for each photograph.

``Externe`` holds the projection centre and a matrix ``CodageMatr`` with rows L1, L2, L3 from camera axes (x
right, y down, z into the scene) to the world: X = R P + C (convention eConvApero_DistM2C). A MicMac world is
Cartesian and does not say what it is: a Euclidean frame MicMac made (``SysCoRTL``: topocentric), or a map
taken as Cartesian; it must be declared.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError
from stereomate.formats.declared import Declared
from stereomate.formats.orientation_set import OrientationSet
from stereomate.formats.text_files import read_text, write_text
from stereomate.frames.attitude import AttitudeConvention, axes_from_camera, written_from_axes

Array = NDArray[np.float64]

KNOWN_CONVENTION: Final = "eConvApero_DistM2C"
_CONVENTION: Final = AttitudeConvention("matrix", "tangent", camera_axes="computer_vision")
_PREFIX: Final = "Orientation-"


def read_micmac(path: Path, declared: Declared) -> OrientationSet:
    """Read a folder of orientations, or one of its files.

    Parameters
    ----------
    path : Path
    declared : Declared
        The frame of the world, and `axes`.

    Raises
    ------
    FormatError
        If there is no such file, one has another convention, or the frame is not declared.
    """
    files = sorted(path.glob(f"{_PREFIX}*.xml")) if path.is_dir() else [path]
    if not files:
        raise FormatError(f"holds no {_PREFIX}*.xml", file=path)
    place = declared.require_place(path)
    axes = declared.require_axes(path, place)
    names, centres, matrices, cameras = [], [], [], []
    for file in files:
        centre, matrix, camera = _orientation(file)
        names.append(file.name.removeprefix(_PREFIX).removesuffix(".xml"))
        centres.append(centre)
        matrices.append(matrix)
        cameras.append(camera)
    return OrientationSet(
        tuple(names),
        np.array(centres) + declared.offset,
        axes_from_camera(np.array(matrices), _CONVENTION),
        place,
        axes,
        tuple(cameras),
        notes=(f"{path.name}: interior orientations (AutoCal) are not read",),
    )


def write_micmac(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write one file a photograph into a folder; returns notes.

    Raises
    ------
    FormatError
        If a name cannot be a file name.
    """
    matrices = written_from_axes(orientations.rotations, _CONVENTION)
    centres = orientations.positions - np.array(declared.offset)
    path.mkdir(parents=True, exist_ok=True)
    for name, camera, centre, matrix in zip(
        orientations.names, orientations.cameras, centres, matrices, strict=True
    ):
        if not name or "/" in name or "\\" in name:
            raise FormatError("must be a file name", file=path, field="name", value=name)
        document = ElementTree.Element("ExportAPERO")
        cone = ElementTree.SubElement(document, "OrientationConique")
        affinity = ElementTree.SubElement(cone, "OrIntImaM2C")
        for tag, value in (("I00", "0 0"), ("V10", "1 0"), ("V01", "0 1")):
            ElementTree.SubElement(affinity, tag).text = value
        ElementTree.SubElement(cone, "TypeProj").text = "eProjStenope"
        ElementTree.SubElement(cone, "ZoneUtileInPixel").text = "true"
        if camera:
            ElementTree.SubElement(cone, "FileInterne").text = camera
        ElementTree.SubElement(cone, "RelativeNameFI").text = "true"
        external = ElementTree.SubElement(cone, "Externe")
        ElementTree.SubElement(external, "KnownConv").text = KNOWN_CONVENTION
        ElementTree.SubElement(external, "Centre").text = _numbers(centre)
        code = ElementTree.SubElement(ElementTree.SubElement(external, "ParamRotation"), "CodageMatr")
        for row, values in enumerate(matrix, 1):
            ElementTree.SubElement(code, f"L{row}").text = _numbers(values)
        convention = ElementTree.SubElement(cone, "ConvOri")
        ElementTree.SubElement(convention, "KnownConv").text = KNOWN_CONVENTION
        ElementTree.indent(document)
        text = ElementTree.tostring(document, encoding="unicode")
        write_text(path / f"{_PREFIX}{name}.xml", f'<?xml version="1.0" ?>\n{text}\n')
    return ("interior orientations (AutoCal) are not written: FileInterne names what the photographs name",)


def _orientation(file: Path) -> tuple[Array, Array, str | None]:
    try:
        root = ElementTree.fromstring(read_text(file))
    except ElementTree.ParseError as error:
        raise FormatError(f"must be XML: {error}", file=file) from error
    cone = root if root.tag == "OrientationConique" else root.find("OrientationConique")
    external = cone.find("Externe") if cone is not None else None
    if cone is None or external is None:
        raise FormatError("must hold OrientationConique / Externe", file=file, value=root.tag)
    conventions = {
        element.text.strip()
        for element in (external.find("KnownConv"), cone.find("ConvOri/KnownConv"))
        if element is not None and element.text
    }
    if conventions - {KNOWN_CONVENTION}:
        raise FormatError(
            f"must be {KNOWN_CONVENTION}", file=file, field="KnownConv", value=sorted(conventions)
        )
    projection = cone.findtext("TypeProj")
    if projection is not None and projection.strip() != "eProjStenope":
        raise FormatError("must be eProjStenope", file=file, field="TypeProj", value=projection)
    centre = _values(file, external, "Centre")
    rows = [_values(file, external, f"ParamRotation/CodageMatr/L{row}") for row in (1, 2, 3)]
    camera = cone.findtext("FileInterne")
    return centre, np.array(rows), camera.strip() if camera and camera.strip() else None


def _values(file: Path, parent: Element, tag: str) -> Array:
    text = parent.findtext(tag)
    try:
        values = np.array([float(part) for part in (text or "").split()])
    except ValueError as error:
        raise FormatError("must be numbers", file=file, field=tag, value=text) from error
    if values.size != 3 or not np.isfinite(values).all():
        raise FormatError("must be 3 numbers", file=file, field=f"Externe/{tag}", value=text)
    return values


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
