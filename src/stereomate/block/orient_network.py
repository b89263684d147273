"""From start values and measurements to the network that is adjusted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.groups import NavigationGroups, one_group
from stereomate.block.network import (
    Attitudes,
    BlockCamera,
    Control,
    ImagePoints,
    Network,
    Photographs,
    Points,
    Positions,
)
from stereomate.block.start import KnownPoints
from stereomate.camera.distortion import BrownDistortion, EbnerDeformation, NoDistortion
from stereomate.camera.model import EBNER_NAMES, Camera
from stereomate.geometry.intersection import Rays, intersect_rays
from stereomate.measurement.tracks import TiePoints

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

# Priors of what is calibrated: how far cameras that nobody calibrated are from nominal.
_PRINCIPAL_DISTANCE_SHARE: Final = 0.03
_PRINCIPAL_POINT_SHARE: Final = 0.02
_PRIORS: Final = {
    "k1": 0.2,
    "k2": 0.2,
    "k3": 0.2,
    "k4": 0.2,
    "p1": 0.01,
    "p2": 0.01,
    "b1": 0.003,
    "b2": 0.003,
    **dict.fromkeys(("k5", "k6"), 0.2),
    **dict.fromkeys(("s1", "s2", "s3", "s4", "taux", "tauy"), 0.01),
    **dict.fromkeys(EBNER_NAMES, 0.05),  # mm: more than film is ever out of shape
}
_PARAMETERS: Final = {
    "principal_distance": ("principal_distance_mm",),
    "principal_point": ("principal_point_x_mm", "principal_point_y_mm"),
    "point_of_symmetry": ("symmetry_x_mm", "symmetry_y_mm"),
    "ebner": EBNER_NAMES,
}
NOMINAL: Final = ("principal_distance", "principal_point", "k1", "k2", "p1", "p2")


@dataclass(frozen=True, eq=False)
class BlockData:
    """Everything that is adjusted together.

    Parameters
    ----------
    names : tuple of str
        Of all photographs of the block.
    camera_of : ndarray of int, shape (n,)
        Which of `cameras` took a photograph.
    cameras : tuple of Camera
    calibrate : mapping of str to tuple of str
        Name of a camera -> keys of what is found too (`NOMINAL` and others of the project file).
    ties : TiePoints
    control : KnownPoints or None
    check : ndarray of bool or None
        Which of the control points are check points.
    control_sigma_px : ndarray or None
        Standard deviations of the measurements of `control`.
    positions : ndarray, shape (n, 3)
        In the tangent frame; NaN for unknown.
    position_sigma_m : (float, float, float)
    attitudes : ndarray, shape (n, 3, 3)
        NaN for unknown.
    attitude_sigma : (float, float, float) or None
        Radians; None: not observed.
    priors : mapping of str to mapping
        Name of a camera -> parameter -> standard deviation of its prior, in the parameter's own unit.
    groups : NavigationGroups or None
        Strips and mounts; None: one of each.
    tie_names : tuple of str or None
        Of the tie points, by their numbers; None: t0, t1, ...
    """

    names: tuple[str, ...]
    camera_of: Integers
    cameras: tuple[Camera, ...]
    calibrate: Mapping[str, tuple[str, ...]]
    ties: TiePoints
    control: KnownPoints | None
    check: Mask | None
    control_sigma_px: Array | None
    positions: Array
    position_sigma_m: tuple[float, float, float]
    attitudes: Array
    attitude_sigma: tuple[float, float, float] | None
    tie_names: tuple[str, ...] | None = None
    priors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    groups: NavigationGroups | None = None

    def camera(self, photo: int) -> Camera:
        """Camera of a photograph."""
        return self.cameras[int(self.camera_of[photo])]

    def with_calibration(self, calibrate: Mapping[str, tuple[str, ...]]) -> BlockData:
        """The same with other parameters to be found."""
        return replace(self, calibrate=dict(calibrate))


@dataclass(frozen=True, eq=False)
class Assembled:
    """A network and what its indices stand for.

    Attributes
    ----------
    network : Network
    photos : ndarray of int
        Photograph of the block for each of the network.
    ties : ndarray of int
        Tie point for each of the first points of the network; control points follow.
    controls : ndarray of int
        Control point of `BlockData.control` for each point after the tie points.
    rows : ndarray of int
        Row of `BlockData.ties` for each of the first image observations of the network.
    """

    network: Network
    photos: Integers
    ties: Integers
    controls: Integers
    rows: Integers


def assemble(
    data: BlockData, centres: Array, rotations: Array, points: Array, with_datum: bool = True
) -> Assembled:
    """The network of all photographs that have an orientation.

    Parameters
    ----------
    data : BlockData
    centres, rotations : ndarray, shape (n, 3) and (n, 3, 3)
        NaN for photographs that take no part.
    points : ndarray, shape (k, 3)
        Tie points; those of NaN take no part.
    with_datum : bool
        Whether positions, attitudes and control points are observations; False: a free network.
    """
    photos = np.flatnonzero(np.isfinite(centres[:, 0]))
    place = np.full(len(data.names), -1, dtype=np.int64)
    place[photos] = np.arange(len(photos))
    ties = data.ties
    known = np.isfinite(points[:, 0]) if len(points) else np.zeros(0, dtype=np.bool_)
    rows = np.flatnonzero((place[ties.photo] >= 0) & known[ties.point])
    count = np.bincount(ties.point[rows], minlength=len(points))
    rows = rows[count[ties.point[rows]] >= 2]
    tie_numbers, tie_index = np.unique(ties.point[rows], return_inverse=True)
    xyz = [points[tie_numbers]]
    own = data.tie_names
    names = [f"t{number}" if own is None else own[number] for number in tie_numbers.tolist()]
    photo, point = [place[ties.photo[rows]]], [tie_index.astype(np.int64)]
    pixels, sigma = [ties.pixels[rows]], [ties.sigma_px[rows]]
    controls = np.empty(0, dtype=np.int64)
    control = None
    if data.control is not None and with_datum:
        controls, start, measured = _controls(data, place, centres, rotations)
        index = np.full(len(data.control.names), -1, dtype=np.int64)
        index[controls] = len(tie_numbers) + np.arange(len(controls))
        xyz.append(start)
        names += [data.control.names[k] for k in controls.tolist()]
        photo.append(place[data.control.photo[measured]])
        point.append(index[data.control.point[measured]])
        pixels.append(data.control.pixels[measured])
        assert data.control_sigma_px is not None  # stated together with the points
        sigma.append(data.control_sigma_px[measured])
        control = _control(data, controls, index[controls])
    network = Network(
        _block_cameras(data, with_datum),
        Photographs(
            tuple(data.names[k] for k in photos.tolist()),
            data.camera_of[photos],
            centres[photos],
            rotations[photos],
        ),
        Points(tuple(names), np.concatenate(xyz)),
        ImagePoints(
            np.concatenate(photo),
            np.concatenate(point),
            np.concatenate(pixels),
            np.repeat(np.concatenate(sigma)[:, None], 2, axis=1),
        ),
        control,
        _positions(data, photos) if with_datum else None,
        _attitudes(data, photos) if with_datum else None,
    )
    return Assembled(network, photos, tie_numbers, controls, rows)


def _controls(
    data: BlockData, place: Integers, centres: Array, rotations: Array
) -> tuple[Integers, Array, Integers]:
    """Control points measured in oriented photographs, their start, and rows of their measurements."""
    control = data.control
    assert control is not None  # asked before
    rows = np.flatnonzero(place[control.photo] >= 0)
    image = np.array(
        [data.camera(int(control.photo[r])).rays_from_image(control.pixels[r])[:2] for r in rows]
    ).reshape(-1, 2)
    good = np.isfinite(image).all(axis=1)
    rows, image = rows[good], image[good]
    photo = control.photo[rows]
    rays = Rays(control.point[rows], centres[photo], rotations[photo], image, np.ones(len(rows)))
    found = intersect_rays(rays, len(control.names)).points
    # A point seen once, or with coordinates of its own, starts from these.
    start = np.where(np.isfinite(found), found, control.xyz)
    measured = np.bincount(control.point[rows], minlength=len(control.names))
    full = np.isfinite(control.xyz).all(axis=1)
    useful = np.isfinite(start).all(axis=1) & ((measured >= 2) | ((measured == 1) & full))
    numbers = np.flatnonzero(useful)
    return numbers, start[numbers], rows[useful[control.point[rows]]]


def _control(data: BlockData, controls: Integers, index: Integers) -> Control:
    control = data.control
    assert control is not None  # asked before
    xyz = control.xyz[controls]
    sigma = np.where(np.isfinite(xyz), control.sigma_m[controls], math.inf)
    check = None if data.check is None else data.check[controls]
    return Control(index, xyz, sigma, None, check)


def _positions(data: BlockData, photos: Integers) -> Positions | None:
    known = np.flatnonzero(np.isfinite(data.positions[photos]).all(axis=1))
    if not len(known):
        return None
    sigma = np.broadcast_to(np.array(data.position_sigma_m), (len(known), 3))
    groups = data.groups or one_group(len(data.names))
    return groups.positions(photos, known, data.positions[photos[known]], sigma)


def _attitudes(data: BlockData, photos: Integers) -> Attitudes | None:
    if data.attitude_sigma is None:
        return None
    known = np.flatnonzero(np.isfinite(data.attitudes[photos]).all(axis=(1, 2)))
    if not len(known):
        return None
    sigma = np.broadcast_to(np.array(data.attitude_sigma), (len(known), 3))
    groups = data.groups or one_group(len(data.names))
    return groups.attitudes(photos, known, data.attitudes[photos[known]], sigma)


def _block_cameras(data: BlockData, with_datum: bool) -> tuple[BlockCamera, ...]:
    result = []
    for camera in data.cameras:
        keys = data.calibrate.get(camera.name, ())
        stated = data.priors.get(camera.name, {})
        result.append(BlockCamera(calibratable(camera, keys), priors(camera, keys, with_datum, stated)))
    return tuple(result)


def parameters_of(key: str) -> tuple[str, ...]:
    """Names of the interior parameters that a key of the project file stands for."""
    return _PARAMETERS.get(key, (key,))


def calibratable(camera: Camera, keys: Sequence[str]) -> Camera:
    """The camera with a distortion, and of film with a deformation, that has the coefficients asked for."""
    names = {name for key in keys for name in parameters_of(key)}
    if isinstance(camera.distortion, NoDistortion) and names & set(BrownDistortion.coefficient_names):
        camera = replace(camera, distortion=BrownDistortion())
    if camera.deformation is None and names & set(EBNER_NAMES):
        (a, b, _), (d, e, _) = camera.pixel_from_photo
        columns, rows = camera.size_px
        whole = columns / math.hypot(a, b), rows / math.hypot(d, e)
        camera = replace(camera, deformation=EbnerDeformation.of_format(camera.format_mm or whole))
    return camera


def priors(
    camera: Camera,
    keys: Sequence[str],
    with_distance: bool = True,
    stated: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """Names of unknown parameters with the standard deviations of their priors: stated, or usual ones."""
    camera = calibratable(camera, keys)
    free: dict[str, float] = {}
    for key in keys:
        if key == "principal_distance" and not with_distance:
            continue
        for name in parameters_of(key):
            if name in camera.parameter_names:
                free[name] = _usual_prior(camera, name)
    return free | {name: sigma for name, sigma in (stated or {}).items() if name in free}


def _usual_prior(camera: Camera, name: str) -> float:
    """How far cameras that nobody calibrated are from nominal."""
    c = camera.principal_distance_mm
    if name == "principal_distance_mm":
        return _PRINCIPAL_DISTANCE_SHARE * c
    if name not in _PRIORS:
        return _PRINCIPAL_POINT_SHARE * c  # principal point, point of symmetry
    distortion = camera.distortion
    if isinstance(distortion, BrownDistortion) and distortion.units == "mm" and name[0] in "kp":
        return _PRIORS[name] / c ** (2 * int(name[1]) if name[0] == "k" else 1)
    return _PRIORS[name]
