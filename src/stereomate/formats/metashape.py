"""Agisoft Metashape: camera XML and omega-phi-kappa text.

The XML holds, for every camera, a 4 x 4 matrix from camera axes (x right, y down, z forward) to the chunk (or
to a component of it), and for the chunk a similarity to geocentric coordinates on the datum of its reference
system. So its orientations are geocentric whatever CRS it names; positions in that CRS are
``reference``, which are measurements and are not read. Calibrations: f, cx, cy in pixels, (cx, cy) from the
middle of the image, b1 and b2 in pixels, p1 and p2 exchanged against OpenCV.

The text (File > Export > Export Cameras, "Omega Phi Kappa") has degrees and a rotation matrix r11 to r33 in
one line. Angles are about axes at each camera that the file does not name.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import CrsError, FormatError
from stereomate.formats.declared import Declared
from stereomate.formats.lens import Lens, lens_of
from stereomate.formats.orientation_set import GeocentricFrame, OrientationSet, Place
from stereomate.formats.orientation_table import MAP_COLUMNS, OPK_COLUMNS, read_orientation_table
from stereomate.formats.text_files import read_text, write_text
from stereomate.frames.attitude import AttitudeConvention, axes_from_camera, written_from_axes
from stereomate.frames.crs import geodetic_of, parse

Array = NDArray[np.float64]

_FLIP: Final = np.diag([1.0, -1.0, -1.0])
_RADIAL: Final = ("k1", "k2", "k3", "k4")
_OPK: Final = AttitudeConvention("opk", "local")
# Angles of the text have a dozen decimals, its matrix too; more than this apart they are not the same
# rotation.
_SAME_ROTATION: Final = 1e-6


def read_metashape_xml(path: Path, declared: Declared) -> OrientationSet:
    """Read the cameras of one chunk.

    Parameters
    ----------
    path : Path
    declared : Declared
        Nothing needs to be; for a chunk in local coordinates, the frame that its coordinates are.

    Raises
    ------
    FormatError
        If it is no such file, holds several chunks, or is not georeferenced and no frame is declared.
    """
    chunk = _chunk(path)
    place = _place(path, chunk, declared)
    sensors = {_id(sensor): camera_of_sensor(path, sensor) for sensor in chunk.iterfind("sensors/sensor")}
    similarities = _similarities(path, chunk)
    names, centres, rotations, cameras = [], [], [], []
    unaligned = 0
    for camera in chunk.iterfind("cameras//camera"):
        element = camera.find("transform")
        if element is None:
            unaligned += 1
            continue
        matrix = _values(path, element, 16, f"camera {camera.get('label')}").reshape(4, 4)
        rotation, shift, scale = similarities.get(camera.get("component_id") or "", similarities[""])
        names.append(camera.get("label") or "")
        centres.append(scale * rotation @ matrix[:3, 3] + shift)
        rotations.append(_rotation(path, rotation @ matrix[:3, :3], names[-1]) @ _FLIP)
        sensor = sensors.get(camera.get("sensor_id") or "")
        cameras.append(sensor.name if sensor is not None else None)
    if not names:
        raise FormatError("holds no aligned camera", file=path)
    notes = [f"{path.name}: orientations are those of the chunk's transform, not the measured reference"]
    if unaligned:
        notes.append(f"{path.name}: {unaligned} cameras are not aligned and left out")
    values = {camera.name: camera for camera in sensors.values() if camera is not None}
    axes = "geocentric" if isinstance(place, GeocentricFrame) else declared.require_axes(path, place)
    return OrientationSet(
        tuple(names), np.array(centres) + declared.offset, np.array(rotations), place, axes,
        tuple(cameras), values, tuple(notes),
    )  # fmt: skip


def write_metashape_xml(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write cameras of one georeferenced chunk; `orientations` are geocentric. Returns notes.

    Raises
    ------
    FormatError
        If a photograph has no camera, or its distortion cannot be written.
    """
    place = orientations.place
    if not isinstance(place, GeocentricFrame):
        raise FormatError("holds geocentric orientations only", file=path, field="crs")
    values = {**orientations.camera_values, **declared.cameras}
    used = list(dict.fromkeys(orientations.cameras))
    document = ElementTree.Element("document", version="2.0.0")
    chunk = ElementTree.SubElement(document, "chunk", label="Chunk 1", enabled="true")
    sensors = ElementTree.SubElement(chunk, "sensors", next_id=str(len(used)))
    for number, name in enumerate(used):
        camera = values.get(name or "") or (
            next(iter(values.values())) if len(values) == 1 and not name else None
        )
        if camera is None:
            rule = "needs the camera of every photograph"
            raise FormatError(rule, file=path, field="camera", value=name, hint="declare cameras")
        _write_sensor(sensors, number, camera)
    # The chunk's own frame is about the middle of the block, so that the matrices keep their digits.
    origin = np.round(orientations.positions.mean(axis=0))
    cameras = ElementTree.SubElement(
        chunk, "cameras", next_id=str(len(orientations.names)), next_group_id="0"
    )
    for number, (name, camera_name) in enumerate(zip(orientations.names, orientations.cameras, strict=True)):
        matrix = np.eye(4)
        matrix[:3, :3] = orientations.rotations[number] @ _FLIP
        matrix[:3, 3] = orientations.positions[number] - origin
        element = ElementTree.SubElement(
            cameras,
            "camera",
            id=str(number),
            sensor_id=str(used.index(camera_name)),
            label=name,
            enabled="true",
        )
        ElementTree.SubElement(element, "transform").text = _numbers(matrix.ravel())
    transform = ElementTree.SubElement(chunk, "transform")
    ElementTree.SubElement(transform, "rotation", locked="true").text = _numbers(np.eye(3).ravel())
    ElementTree.SubElement(transform, "translation", locked="true").text = _numbers(origin)
    ElementTree.SubElement(transform, "scale", locked="true").text = "1"
    ElementTree.SubElement(chunk, "reference").text = parse(place.geodetic.crs).to_wkt("WKT1_GDAL")
    ElementTree.indent(document)
    text = ElementTree.tostring(document, encoding="unicode", xml_declaration=False)
    write_text(path, '<?xml version="1.0" encoding="UTF-8"?>\n' + text + "\n")
    return (f"the chunk's reference system is {place.geodetic.name}",)


def read_metashape_opk(path: Path, declared: Declared) -> OrientationSet:
    """Read an exported table of cameras with omega, phi, kappa (degrees) and, where it has one, its matrix.

    Parameters
    ----------
    path : Path
    declared : Declared
        The CRS the table was exported in, its heights, and `axes`.

    Raises
    ------
    FormatError
        If it is no such table, angles and matrix contradict each other, or something is not declared.
    """
    table = read_orientation_table(path, declared.columns, declared.separator)
    if not table.has((*MAP_COLUMNS, *OPK_COLUMNS)):
        raise FormatError("must have the columns X, Y, Z, Omega, Phi, Kappa", file=path, value=table.columns)
    place = declared.require_place(path)
    axes = declared.require_axes(path, place)
    unit = declared.require_unit(path, np.zeros(1), "deg")
    angles = np.array([row.values(OPK_COLUMNS) for row in table.rows])
    rotations = axes_from_camera(angles, AttitudeConvention("opk", axes, unit))
    notes = [f"{path.name}: angles are omega-phi-kappa in degrees (Metashape's format)"]
    matrices = _matrices(path, len(table.rows))
    if matrices is not None:
        notes.append(
            f"{path.name}: its matrices are {_direction(path, matrices, rotations)}, as the angles say"
        )
    positions = np.array([row.values(MAP_COLUMNS) for row in table.rows]) + declared.offset
    names = tuple(row.name for row in table.rows)
    return OrientationSet(names, positions, rotations, place, axes, notes=tuple(notes))


def write_metashape_opk(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write the table as Metashape does: tabs, degrees, matrices from object to camera. Returns notes."""
    angles = written_from_axes(orientations.rotations, _OPK)
    centres = orientations.positions - np.array(declared.offset)
    lines = [
        f"# Cameras ({len(orientations.names)})",
        "#PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13, r21, r22, r23, r31, r32, r33",
    ]
    for name, centre, opk, rotation in zip(
        orientations.names, centres, angles, orientations.rotations, strict=True
    ):
        values = (*centre, *opk, *rotation.T.ravel())
        lines.append("\t".join((name, *(f"{value:.16g}" for value in values))))
    write_text(path, "\n".join(lines) + "\n")
    return (f"angles are omega-phi-kappa in degrees about {orientations.axes} axes",)


def _chunk(path: Path) -> Element:
    try:
        root = ElementTree.fromstring(read_text(path))
    except ElementTree.ParseError as error:
        raise FormatError(f"must be XML: {error}", file=path) from error
    chunks = root.findall("chunk")
    if root.tag != "document" or not chunks:
        raise FormatError(
            "must be a document with a chunk, as Metashape exports cameras", file=path, value=root.tag
        )
    if len(chunks) > 1:
        raise FormatError("holds several chunks; export one", file=path, value=len(chunks))
    return chunks[0]


def _place(path: Path, chunk: Element, declared: Declared) -> Place:
    reference = (chunk.findtext("reference") or "").strip()
    if reference and not reference.startswith(("LOCAL_CS", "ENGCRS", "EngineeringCRS")):
        try:
            datum = geodetic_of(reference).crs
        except CrsError as error:
            raise FormatError(
                f"names a reference system that {error.rule}", file=path, field="reference"
            ) from error
        return GeocentricFrame(datum)
    return declared.require_place(path)


_Similarity = tuple[Array, Array, float]


def _similarities(path: Path, chunk: Element) -> dict[str, _Similarity]:
    """To the world from each component, by its id; from the chunk under an empty id.

    A component's transform replaces the chunk's, which is that of the active component where both are there.
    """
    whole = _similarity(path, chunk.find("transform"))
    found = {
        _id(part): _similarity(path, part.find("transform"))
        for part in chunk.iterfind("components/component")
    }
    parts = {name: value for name, value in found.items() if value is not None}
    if whole is not None and parts and not any(_equal(whole, part) for part in parts.values()):
        raise FormatError(
            "has a transform of the chunk and others of its components, and none agree: which of them "
            "lead to the world is not documented",
            file=path,
            field="transform",
        )
    identity = (np.eye(3), np.zeros(3), 1.0)
    return {"": whole or (next(iter(parts.values())) if len(parts) == 1 else identity), **parts}


def _equal(first: _Similarity, second: _Similarity) -> bool:
    parts = [np.concatenate([r.ravel(), t, [s]]) for r, t, s in (first, second)]
    return bool(np.allclose(parts[0], parts[1], rtol=1e-9, atol=1e-9))


def _similarity(path: Path, element: Element | None) -> _Similarity | None:
    rotation = element.find("rotation") if element is not None else None
    if element is None or rotation is None:
        return None
    matrix = _values(path, rotation, 9, "transform.rotation").reshape(3, 3)
    translation, scale = element.find("translation"), element.find("scale")
    shift = np.zeros(3) if translation is None else _values(path, translation, 3, "transform.translation")
    factor = 1.0 if scale is None else float(_values(path, scale, 1, "transform.scale")[0])
    return matrix, shift, factor


def _rotation(path: Path, matrix: Array, name: str) -> Array:
    u, s, vt = np.linalg.svd(matrix)
    if np.abs(s - 1.0).max() > 1e-6 or np.linalg.det(matrix) < 0.0:
        raise FormatError(
            "must be a rotation", file=path, field=f"camera {name}: transform", value=matrix.tolist()
        )
    result: Array = u @ vt
    return result


def _values(path: Path, element: Element, count: int, field: str) -> Array:
    try:
        values = np.array([float(part) for part in (element.text or "").split()])
    except ValueError as error:
        raise FormatError("must be numbers", file=path, field=field, value=element.text) from error
    if values.size != count or not np.isfinite(values).all():
        raise FormatError(f"must be {count} numbers", file=path, field=field, value=values.size)
    return values


def _id(element: Element) -> str:
    return element.get("id") or ""


def camera_of_sensor(path: Path, element: Element) -> Camera | None:
    """The camera of a ``sensor``: its adjusted calibration, else its first; None without any."""
    label = element.get("label") or f"sensor {_id(element)}"
    calibrations = element.findall("calibration")
    chosen = next((c for c in calibrations if c.get("class") == "adjusted"), None)
    chosen = chosen if chosen is not None else (calibrations[0] if calibrations else None)
    resolution = chosen.find("resolution") if chosen is not None else None
    if chosen is None or resolution is None:
        return None
    field = f"sensor {label}"
    kind = chosen.get("type") or "frame"
    if kind not in ("frame", "fisheye"):
        raise FormatError("must be of type frame or fisheye", file=path, field=field, value=kind)
    if chosen.find("f") is None:
        raise FormatError("has no f (a file older than PhotoScan 1.3 is not read)", file=path, field=field)

    def number(tag: str) -> float:
        child = chosen.find(tag)
        return 0.0 if child is None else float(_values(path, child, 1, f"{field}: {tag}")[0])

    size = (int(resolution.get("width") or 0), int(resolution.get("height") or 0))
    f, b1, b2 = number("f"), number("b1"), number("b2")
    if kind == "fisheye" and (b1 or b2 or number("p1") or number("p2")):
        raise FormatError("has a fisheye with p1, p2, b1 or b2, which is not read", file=path, field=field)
    if number("p3") or number("p4"):
        raise FormatError("has p3 or p4, which are not read", file=path, field=field)
    k1, k2, k3, k4 = (number(tag) for tag in _RADIAL)
    return Lens(
        "fisheye" if kind == "fisheye" else "brown",
        size, f + b1, f, size[0] / 2.0 + number("cx"), size[1] / 2.0 + number("cy"),
        (k1, k2, k3, k4), number("p2"), number("p1"), b2 / (f + b1),
    ).camera(label)  # fmt: skip


def _write_sensor(parent: Element, number: int, camera: Camera) -> None:
    lens = lens_of(camera)
    kind = "fisheye" if lens.kind == "fisheye" else "frame"
    size = {"width": str(lens.size_px[0]), "height": str(lens.size_px[1])}
    sensor = ElementTree.SubElement(parent, "sensor", id=str(number), label=camera.name, type=kind)
    ElementTree.SubElement(sensor, "resolution", size)
    calibration = ElementTree.SubElement(sensor, "calibration", {"type": kind, "class": "adjusted"})
    ElementTree.SubElement(calibration, "resolution", size)
    values: Mapping[str, float] = {
        "f": lens.fy,
        "cx": lens.cx - lens.size_px[0] / 2.0,
        "cy": lens.cy - lens.size_px[1] / 2.0,
        "b1": lens.fx - lens.fy,
        "b2": lens.shear * lens.fx,
        **dict(zip(_RADIAL, lens.radial, strict=True)),
        "p1": lens.p2,
        "p2": lens.p1,
    }
    for tag, value in values.items():
        if value or tag == "f":
            ElementTree.SubElement(calibration, tag).text = repr(float(value))


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _matrices(path: Path, count: int) -> Array | None:
    rows = [
        line.split("\t") for line in read_text(path).splitlines() if line.strip() and not line.startswith("#")
    ]
    rows = [row for row in rows if len(row) == 16]
    if len(rows) != count:
        return None
    return np.array([[float(cell) for cell in row[7:]] for row in rows]).reshape(-1, 3, 3)


def _direction(path: Path, matrices: Array, rotations: Array) -> str:
    direct = float(np.abs(matrices - rotations).max())
    inverse = float(np.abs(np.swapaxes(matrices, -1, -2) - rotations).max())
    if min(direct, inverse) > _SAME_ROTATION:
        rule = f"has angles and matrices that differ by {min(direct, inverse):.2g}"
        raise FormatError(rule, file=path, field="r11 to r33")
    return "object from camera" if direct <= inverse else "camera from object"
