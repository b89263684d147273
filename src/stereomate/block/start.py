"""Start values of a block without approximate values: models joined of pairs, in the tangent frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.block.growing import model_adjuster
from stereomate.block.joining import join
from stereomate.block.models import Adjuster, BlockImages, JoiningOptions, Model, PairPose
from stereomate.block.start_datum import Datum, Places, find_datum
from stereomate.camera.model import Camera
from stereomate.errors import NotDeterminedError
from stereomate.geometry.intersection import Rays, intersect_rays
from stereomate.measurement.tracks import TiePoints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KnownPositions:
    """Projection centres in the tangent frame, shape (n, 3), NaN for unknown; sigma east, north, up.

    `rotations` are stated ones, shape (n, 3, 3), NaN for unknown: they help where centres leave a tilt open.
    """

    centres: Array
    sigma_m: tuple[float, float, float]
    rotations: Array | None = None


@dataclass(frozen=True)
class KnownPoints:
    """Control points measured in photographs.

    Parameters
    ----------
    names : tuple of str
    xyz : ndarray, shape (k, 3)
        In the tangent frame; NaN for an axis that is not known.
    sigma_m : ndarray, shape (k, 3)
    point, photo : ndarray of int, shape (m,)
        Which point is measured in which photograph.
    pixels : ndarray, shape (m, 2)
    """

    names: tuple[str, ...]
    xyz: Array
    sigma_m: Array
    point: NDArray[np.int64]
    photo: NDArray[np.int64]
    pixels: Array


@dataclass(frozen=True)
class StartPart:
    """A connected part of the block in the tangent frame (or, with a datum of kind "none", in its own).

    Attributes
    ----------
    photos : ndarray of int
        Which photographs.
    centres, rotations : ndarray, shape (n, 3) and (n, 3, 3)
        Of all photographs of the block; NaN for those of other parts.
    points : ndarray, shape (k, 3)
        Tie points; NaN where not determined.
    datum : Datum
    """

    photos: NDArray[np.int64]
    centres: Array
    rotations: Array
    points: Array
    used: NDArray[np.bool_]
    datum: Datum


@dataclass(frozen=True)
class Start:
    """Start values of a block.

    Attributes
    ----------
    parts : tuple of StartPart
        The largest first.
    reasons : mapping of int to str
        Why photographs could not be joined.
    """

    parts: tuple[StartPart, ...]
    reasons: Mapping[int, str]


def block_images(points: TiePoints, cameras: Sequence[Camera]) -> tuple[BlockImages, NDArray[np.int64]]:
    """Observations as ideal image coordinates, and which rows of `points` they are.

    Rows beyond the range of a camera's distortion are left out.
    """
    image, sigma = np.full((len(points), 2), np.nan), np.full(len(points), np.nan)
    for k, camera in enumerate(cameras):
        mine = points.photo == k
        if mine.any():
            image[mine] = camera.rays_from_image(points.pixels[mine])[:, :2]
            sigma[mine] = points.sigma_px[mine] / principal_distance_px(camera)
    rows = np.flatnonzero(np.isfinite(image).all(axis=1))
    count = int(points.point.max()) + 1 if len(points) else 0
    images = BlockImages(
        len(cameras), count, points.photo[rows], points.point[rows], image[rows], sigma[rows]
    )
    return images, rows


def principal_distance_px(camera: Camera) -> float:
    """Principal distance in pixels, the mean of both directions."""
    (a, b, _), (d, e, _) = camera.pixel_from_photo
    return float(camera.principal_distance_mm * np.sqrt(abs(a * e - b * d)))


def find_start(
    points: TiePoints,
    cameras: Sequence[Camera],
    pairs: Sequence[PairPose],
    positions: KnownPositions | None = None,
    control: KnownPoints | None = None,
    adjuster: Callable[[BlockImages], Adjuster] | None = None,
    options: JoiningOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Start:
    """Start values of a block.

    Parameters
    ----------
    points : TiePoints
    cameras : sequence of Camera
        Of every photograph.
    pairs : sequence of PairPose
        Determined relative orientations.
    positions, control : optional
        What determines the datum; control is preferred where it does.
    adjuster : callable, optional
        Makes what adjusts a model while it grows; `growing.model_adjuster` if None.
    options, progress : optional
        Of `join`.

    Raises
    ------
    NotDeterminedError
        If no pair gives a model to begin with.
    """
    images, rows = block_images(points, cameras)
    make = adjuster or model_adjuster
    joining = join(images, pairs, make(images), options, progress)
    if not joining.models:
        raise NotDeterminedError(
            "start of the block: no pair of photographs gives a model to begin with ("
            + "; ".join(sorted(set(joining.reasons.values()))[:3])
            + ")"
        )
    parts = []
    for model in joining.models:
        parts.append(_placed(model, images, rows, len(points), cameras, positions, control))
    return Start(tuple(parts), joining.reasons)


def _placed(
    model: Model,
    images: BlockImages,
    rows: NDArray[np.int64],
    count: int,
    cameras: Sequence[Camera],
    positions: KnownPositions | None,
    control: KnownPoints | None,
) -> StartPart:
    joined = model.joined
    sources = []
    if control is not None:
        sources.append(control_places(model.centres, model.rotations, cameras, control))
    if positions is not None:
        known = joined & np.isfinite(positions.centres).all(axis=1)
        sources.append(
            Places(
                "positions",
                tuple(str(k) for k in np.flatnonzero(known)),
                model.centres[known],
                positions.centres[known],
                np.broadcast_to(np.array(positions.sigma_m), (int(np.count_nonzero(known)), 3)),
            )
        )
    stated = None if positions is None or positions.rotations is None else positions.rotations[joined]
    datum = find_datum(model.rotations[joined], tuple(s for s in sources if len(s.names)), stated)
    model.moved(datum.transform)
    used = np.zeros(count, dtype=np.bool_)
    used[rows] = model.used & joined[images.photo] & np.isfinite(model.points[images.point, 0])
    return StartPart(np.flatnonzero(joined), model.centres, model.rotations, model.points, used, datum)


def control_places(
    centres: Array, rotations: Array, cameras: Sequence[Camera], control: KnownPoints
) -> Places:
    """Control points intersected by oriented photographs (those without orientation are NaN)."""
    rows = np.flatnonzero(np.isfinite(centres[control.photo, 0]))
    image = np.array(
        [cameras[control.photo[r]].rays_from_image(control.pixels[r])[:2] for r in rows.tolist()]
    ).reshape(-1, 2)
    good = np.isfinite(image).all(axis=1)
    rows, image = rows[good], image[good]
    photo = control.photo[rows]
    sigma = np.array([1.0 / principal_distance_px(cameras[k]) for k in photo.tolist()])
    rays = Rays(control.point[rows], centres[photo], rotations[photo], image, sigma)
    found = intersect_rays(rays, len(control.names)).points
    known = np.flatnonzero(np.isfinite(found).all(axis=1))
    return Places(
        "control",
        tuple(control.names[k] for k in known.tolist()),
        found[known],
        control.xyz[known],
        control.sigma_m[known],
    )


def start_record(start: Start, names: Sequence[str]) -> dict[str, Any]:
    """The start values as plain numbers, for a file that a run goes on from."""
    return {
        "parts": [
            {
                "photographs": [names[k] for k in part.photos.tolist()],
                "centres": part.centres[part.photos].tolist(),
                "rotations": part.rotations[part.photos].tolist(),
                "datum": part.datum.kind,
                "scale": part.datum.transform.scale,
                "outliers": list(part.datum.outliers),
                "notes": list(part.datum.notes),
            }
            for part in start.parts
        ],
        "not_joined": {names[k]: reason for k, reason in sorted(start.reasons.items())},
    }
