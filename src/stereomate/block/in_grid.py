"""The same adjustment in the map grid taken as Cartesian, to compare with the rigorous one (Ressl 2002).

Indirect georeferencing by other software: image coordinates corrected for earth curvature (P1), then nothing
more, heights multiplied by the scale (M2) or the principal distance divided by it (M3), with the principal
distance held or free. Their differences to the rigorous adjustment are tabulated; nothing of this is used by
products.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.block.adjustment import BlockAdjustment, adjust_block
from stereomate.block.network import BlockCamera, Network
from stereomate.frames.adjusted import effective_scale_at
from stereomate.frames.curvature import CurvatureOptions, curvature_corrected
from stereomate.frames.factors import gauss_radius
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.remedies import GridBlock, cartesian_from_map, grid_principal_distance
from stereomate.frames.tangent import TangentFrame
from stereomate.frames.transform import map_from_tangent

Array = NDArray[np.float64]
Method = Literal["P1", "M2", "M3"]

_AXES: Final = 3


@dataclass(frozen=True, eq=False)
class GridComparison:
    """One way to adjust in the grid, against the rigorous adjustment.

    Attributes
    ----------
    method : {"P1", "M2", "M3"}
        Curvature correction alone; with scaled heights; with scaled principal distance.
    free : tuple of str
        Interior parameters that were free.
    points, centres : ndarray, shape (3,)
        Mean difference in the grid, grid adjustment minus rigorous one: east, north, height; metres.
    points_rms, centres_rms : ndarray, shape (3,)
    principal_distance_mm : float
    rms_px : float
    adjustment : BlockAdjustment
        In the grid, about its mean centre.
    """

    method: Method
    free: tuple[str, ...]
    points: Array
    points_rms: Array
    centres: Array
    centres_rms: Array
    principal_distance_mm: float
    rms_px: float
    adjustment: BlockAdjustment


def compare_in_grid(
    rigorous: BlockAdjustment,
    tangent: TangentFrame,
    frame: MapFrame,
    method: Method,
    free: Mapping[str, float] | None = None,
) -> GridComparison:
    """Adjust the network of a rigorous adjustment again in the grid, one camera, and compare.

    Parameters
    ----------
    rigorous : BlockAdjustment
        Its adjusted values are the start; control and positions are taken over, attitudes are not.
    tangent : TangentFrame
        Of the rigorous network.
    frame : MapFrame
        Conformal map with ellipsoidal heights.
    method : {"P1", "M2", "M3"}
    free : mapping, optional
        Free interior parameters, as in `BlockCamera`.
    """
    base = rigorous.adjusted_network()
    photos, xyz = base.photographs, base.points.xyz
    count = len(photos.names)
    block = GridBlock(tangent, frame, photos.centres, photos.rotations, np.ones(count))
    ground = map_from_tangent(tangent, frame, xyz)
    heights = ground[:, 2] if rigorous.network.control is None else _control_heights(base, tangent, frame)
    level = float(np.mean(heights))
    scale = float(np.mean(effective_scale_at(frame, ground[:, :2], level)))
    factor = scale if method == "M2" else 1.0
    origin = np.array([*block.grid_centres[:, :2].mean(axis=0), 0.0])
    unit = np.array([1.0, 1.0, factor])

    def to_grid(points: Array) -> Array:
        return np.asarray(
            (cartesian_from_map(frame, map_from_tangent(tangent, frame, points)) - origin) * unit
        )

    network = replace(
        base,
        cameras=_cameras(base, scale if method == "M3" else 1.0, free or {}),
        image=replace(base.image, xy=_flat_image(base, block, ground, frame)),
        photographs=replace(photos, centres=to_grid(photos.centres), rotations=block.grid_rotations),
        points=replace(base.points, xyz=to_grid(xyz)),
        control=None if base.control is None else replace(base.control, xyz=to_grid(base.control.xyz)),
        positions=None
        if base.positions is None
        else replace(base.positions, xyz=to_grid(base.positions.xyz)),
        attitudes=None,
    )
    result = adjust_block(network, replace(rigorous.options, statistics=False, robust="none"))
    known = np.isfinite(rigorous.points[:, 0]) & np.isfinite(result.points[:, 0])
    by_points = (result.points[known] - to_grid(xyz)[known]) / unit
    here = result.determined_photos
    by_centres = (result.centres - to_grid(photos.centres))[here] / unit
    used = result.residuals[result.used]
    return GridComparison(
        method,
        tuple(free or {}),
        by_points.mean(axis=0),
        np.sqrt(np.mean(by_points**2, axis=0)),
        by_centres.mean(axis=0),
        np.sqrt(np.mean(by_centres**2, axis=0)),
        result.cameras[0].principal_distance_mm,
        float(np.sqrt(np.mean(used**2))),
        result,
    )


def _control_heights(network: Network, tangent: TangentFrame, frame: MapFrame) -> Array:
    assert network.control is not None
    places = map_from_tangent(tangent, frame, network.points.xyz[network.control.point])
    return np.asarray(places[:, _AXES - 1])


def _cameras(network: Network, scale: float, free: Mapping[str, float]) -> tuple[BlockCamera, ...]:
    return tuple(
        BlockCamera(
            replace(
                entry.camera,
                principal_distance_mm=float(
                    grid_principal_distance(entry.camera.principal_distance_mm, scale)
                ),
            ),
            free,
        )
        for entry in network.cameras
    )


def _flat_image(network: Network, block: GridBlock, ground: Array, frame: MapFrame) -> Array:
    """Image points corrected for earth curvature by the classical formula, with the height of each point."""
    datum = frame.geodetic
    lon_lat = frame.geodetic_from_map(ground)
    radius = float(np.mean(gauss_radius(datum.semi_major_m, datum.flattening, lon_lat[:, 1])))
    photo, point = network.image.photo, network.image.point
    pixels = np.empty_like(network.image.xy)
    for c, entry in enumerate(network.cameras):
        rows = np.flatnonzero(network.photographs.camera[photo] == c)
        rays = entry.camera.rays_from_image(network.image.xy[rows])
        flat = curvature_corrected(
            rays[:, :2],
            1.0,
            block.grid_rotations[photo[rows]],
            block.grid_centres[photo[rows], 2],
            ground[point[rows], 2],
            CurvatureOptions(radius, "classical"),
        )
        pixels[rows], _ = entry.camera.image_from_camera(np.column_stack([flat, -np.ones(len(rows))]))
    return pixels
