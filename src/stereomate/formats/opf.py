"""OPF, the Open Photogrammetry Format, through Pix4D's library pyopf (an extra: ``pip install
stereomate[opf]``).

Calibrated cameras are in a translated canonical frame: ``canonical = shift + swap(scale * base)`` with *base*
the coordinates of the CRS of the scene reference frame and *swap* exchanging x and y of left-handed ones.
Angles are omega, phi, kappa in degrees, R = Rx(omega) Ry(phi) Rz(kappa) from camera axes (x right, y up, z
backwards) to that frame, that is to the right-handed working frame of the map, which OPF takes as Cartesian.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from stereomate.camera.model import Camera
from stereomate.errors import FormatError
from stereomate.formats.declared import Declared
from stereomate.formats.lens import Lens, lens_of
from stereomate.formats.orientation_set import OrientationSet
from stereomate.frames.attitude import AttitudeConvention, axes_from_camera, written_from_axes
from stereomate.frames.factors import grid_axes
from stereomate.frames.mapframe import MapFrame

Array = NDArray[np.float64]

_CONVENTION: Final = AttitudeConvention("opk", "grid", "deg")
_PROJECT: Final = "project.opf"


def read_opf(path: Path, declared: Declared) -> OrientationSet:
    """Read the calibrated cameras of an OPF project.

    Parameters
    ----------
    path : Path
        ``project.opf``, or the folder it is in.
    declared : Declared
        Heights; the CRS only to overrule the one of the scene reference frame.

    Raises
    ------
    FormatError
        If pyopf is not installed, or the project has no calibration or no scene reference frame.
    """
    project = _project(path / _PROJECT if path.is_dir() else path)
    scene, calibration = project.scene_reference_frame, project.calibration
    if scene is None:
        raise FormatError("has no scene reference frame", file=path)
    if calibration is None or calibration.calibrated_cameras is None:
        raise FormatError("has no calibrated cameras", file=path)
    if project.camera_list is None:
        raise FormatError("has no camera list, which names the photographs", file=path)
    place = declared.require_map(path, scene.crs.definition)
    uris = {int(camera.id): camera.uri for camera in project.camera_list.cameras}
    cameras = calibration.calibrated_cameras.cameras
    values, names = _sensors(project)
    canonical = np.array([camera.position for camera in cameras], dtype=np.float64)
    angles = np.array([camera.orientation_deg for camera in cameras], dtype=np.float64)
    notes = [f"{path.name}: angles are about the axes of the map, which OPF takes as Cartesian"]
    if scene.crs.geoid_height is not None and place.heights.kind == "undeclared":
        notes.append(
            f"{path.name}: states a constant geoid height of {scene.crs.geoid_height:g}, not applied"
        )
    return OrientationSet(
        tuple(_name(path, uris, int(camera.id)) for camera in cameras),
        _map_from_canonical(path, scene.base_to_canonical, place, canonical) + declared.offset,
        axes_from_camera(angles, _CONVENTION),
        place,
        declared.axes or "grid",
        tuple(names.get(int(camera.sensor_id)) for camera in cameras),
        values,
        tuple(notes),
    )


def write_opf(path: Path, orientations: OrientationSet, declared: Declared) -> tuple[str, ...]:
    """Write a project of camera list, scene reference frame and calibrated cameras into a folder; returns
    notes.

    Raises
    ------
    FormatError
        If pyopf is not installed, the positions are not map coordinates, or a camera cannot be written.
    """
    place = orientations.place
    if not isinstance(place, MapFrame):
        raise FormatError("holds map coordinates only", file=path, field="crs")
    pyopf = _pyopf()
    swap = grid_axes(place.crs).left_handed
    # OPF wants small numbers: the middle of the block is the origin.
    centres = orientations.positions - np.array(declared.offset)
    working = centres[:, [1, 0, 2]] if swap else centres
    shift = -np.round(working.mean(axis=0))
    transform = pyopf.crs.BaseToTranslatedCanonicalCrsTransform(np.ones(3), shift, swap)
    objects = pyopf.project.ProjectObjects()
    objects.metadata.name = path.name
    objects.metadata.generator = pyopf.project.Generator("stereomate", "1")
    objects.scene_reference_frame_objs.append(
        pyopf.crs.SceneReferenceFrame(transform, pyopf.crs.Crs(place.crs))
    )
    uids = [pyopf.uid64.Uid64(int=number) for number in range(1, len(orientations.names) + 1)]
    objects.camera_list_objs.append(
        pyopf.cameras.CameraList(
            [
                pyopf.cameras.CameraData(uid, quote(name))
                for uid, name in zip(uids, orientations.names, strict=True)
            ]
        )
    )
    values = {**orientations.camera_values, **declared.cameras}
    used = list(dict.fromkeys(orientations.cameras))
    sensors = [_sensor(pyopf, path, number, name, values) for number, name in enumerate(used, 1)]
    angles = written_from_axes(orientations.rotations, _CONVENTION)
    cameras = [
        pyopf.cameras.CalibratedCamera(uid, pyopf.uid64.Uid64(int=used.index(camera) + 1), opk, position)
        for uid, camera, opk, position in zip(
            uids, orientations.cameras, angles, working + shift, strict=True
        )
    ]
    calibration = pyopf.project.Calibration()
    calibration.calibrated_cameras_objs.append(pyopf.cameras.CalibratedCameras(cameras, sensors))
    objects.calibration_objs.append(calibration)
    _describe(pyopf, objects, calibration)
    path.mkdir(parents=True, exist_ok=True)
    pyopf.io.save(objects, path / _PROJECT, use_item_name_for_resource_uri=True)
    return ("image sizes belong to input cameras, which are not written: only calibrated ones are",)


def _pyopf() -> Any:
    try:
        import pyopf
        import pyopf.cameras
        import pyopf.crs
        import pyopf.io
        import pyopf.project
        import pyopf.resolve
        import pyopf.uid64
    except ImportError as error:
        rule = "needs the package pyopf, which is not installed"
        raise FormatError(rule, field="opf", hint='pip install "stereomate[opf]"') from error
    return pyopf


def _project(path: Path) -> Any:
    pyopf = _pyopf()
    if not path.is_file():
        raise FormatError("does not exist", file=path)
    try:
        # Items it does not know are told by a warning; they are not asked for here.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return pyopf.resolve.resolve(pyopf.io.load(path))
    except (RuntimeError, ValueError, KeyError, TypeError, AssertionError, OSError) as error:
        raise FormatError(f"is no OPF project that pyopf reads: {error}", file=path) from error


def _name(path: Path, uris: dict[int, str], uid: int) -> str:
    if uid not in uris:
        raise FormatError("has a calibrated camera that its camera list does not have", file=path, value=uid)
    return unquote(uris[uid]).rsplit("/", 1)[-1]


def _map_from_canonical(path: Path, transform: Any, place: MapFrame, canonical: Array) -> Array:
    scale, shift = np.asarray(transform.scale), np.asarray(transform.shift)
    if (scale <= 0.0).any():
        raise FormatError(
            "must be positive", file=path, field="base_to_canonical.scale", value=scale.tolist()
        )
    # Canonical axes are the working frame of the map, whichever order the base CRS has on paper.
    working = canonical - shift
    swapped = working[:, [1, 0, 2]]
    base = (swapped if transform.swap_xy else working) / scale
    if not np.isclose(scale[0], scale[1]):
        raise FormatError("scales x and y differently", file=path, field="base_to_canonical.scale")
    in_map_order = grid_axes(place.crs).left_handed == bool(transform.swap_xy)
    result: Array = base if in_map_order else base[:, [1, 0, 2]]
    return result


def _sensors(project: Any) -> tuple[dict[str, Camera], dict[int, str]]:
    """Cameras by name and the names by sensor, where the input cameras tell the image size."""
    inputs = (
        {int(sensor.id): sensor for sensor in project.input_cameras.sensors} if project.input_cameras else {}
    )
    values: dict[str, Camera] = {}
    names: dict[int, str] = {}
    for sensor in project.calibration.calibrated_cameras.sensors:
        number = int(sensor.id)
        names[number] = f"sensor {number}"
        size = inputs[number].image_size_px if number in inputs else None
        internals = sensor.internals
        if size is None or getattr(internals, "type", "") != "perspective":
            continue
        k1, k2, k3 = (float(v) for v in internals.radial_distortion)
        p1, p2 = (float(v) for v in internals.tangential_distortion)
        cx, cy = (float(v) for v in internals.principal_point_px)
        focal = float(internals.focal_length_px)
        lens = Lens("brown", (int(size[0]), int(size[1])), focal, focal, cx, cy, (k1, k2, k3, 0.0), p1, p2)
        values[names[number]] = lens.camera(names[number])
    return values, names


def _sensor(pyopf: Any, path: Path, number: int, name: str | None, values: dict[str, Camera]) -> Any:
    camera = values.get(name or "")
    if camera is None and name is None and len(values) == 1:
        camera = next(iter(values.values()))
    if camera is None:
        rule = "needs the camera of every photograph"
        raise FormatError(rule, file=path, field="camera", value=name, hint="declare cameras")
    lens = lens_of(camera)
    if lens.kind == "fisheye" or lens.radial[3] or lens.shear or abs(lens.fx - lens.fy) > 1e-9 * lens.fy:
        rule = (
            "is a fisheye, or has k4, shear or two focal lengths, which OPF's perspective camera cannot hold"
        )
        raise FormatError(rule, file=path, field=f"camera {camera.name!r}")
    internals = pyopf.cameras.PerspectiveInternals(
        np.array([lens.cx, lens.cy]), lens.fx, np.array(lens.radial[:3]), np.array([lens.p1, lens.p2])
    )
    return pyopf.cameras.CalibratedSensor(pyopf.uid64.Uid64(int=number), internals)


def _describe(pyopf: Any, objects: Any, calibration: Any) -> None:
    """Metadata that pyopf asks of each item, with the items a calibration depends on."""
    kinds = pyopf.project.CoreProjectItemType
    metadata = pyopf.project.metadata.Metadata
    cameras, scene = objects.camera_list_objs[0], objects.scene_reference_frame_objs[0]
    cameras.metadata = metadata(type=kinds.CAMERA_LIST, name="camera list")
    scene.metadata = metadata(type=kinds.SCENE_REFERENCE_FRAME, name="scene reference frame")
    sources: Sequence[Any] = [
        pyopf.project.ProjectSource(item.metadata.id, item.metadata.type) for item in (cameras, scene)
    ]
    calibration.metadata = metadata(type=kinds.CALIBRATION, name="calibration", sources=list(sources))
