"""What accuracy a block could be expected to have before the flight, beside what its adjustment found.

The geometry as it was planned: centres where positions are known, cameras looking straight down, level
ground, tie points in a regular pattern, everything measured with the standard deviations that were stated.
Such a block is adjusted without errors; its covariances are the forecast.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.adjustment import BlockAdjustment, adjust_block
from stereomate.block.network import Control, ImagePoints, Network, Photographs, Points
from stereomate.block.options import BlockOptions
from stereomate.errors import NotDeterminedError
from stereomate.project.orient_adjust import Adjusted
from stereomate.project.orient_measure import Measured

Array = NDArray[np.float64]

# Tie points of a photograph in the forecast: more only cost time, their accuracy stands for that of one.
_PER_PHOTO: Final = 100
# Ratios beyond these are worth a reader's attention.
_WORSE: Final = 2.0


def expected_accuracy(measured: Measured, adjusted: Adjusted) -> dict[str, Any] | None:
    """The forecast and what was found, per axis; None for a block without datum or without statistics."""
    result = adjusted.result
    if not adjusted.has_datum or result.statistics is None:
        return None
    sigma_px = float(np.median(measured.ties.sigma_px))
    rays = np.bincount(result.network.image.photo[result.used], minlength=len(result.centres))
    per_photo = int(min(_PER_PHOTO, max(12, float(np.median(rays)))))
    try:
        forecast = adjust_block(
            planned_network(result, sigma_px, per_photo),
            BlockOptions(robust="none", scale_by="prior", max_iterations=3),
        )
    except NotDeterminedError:
        return None
    if forecast.statistics is None:
        return None
    expected, found = _figures(forecast), _figures(result)
    return {
        "assumed": {
            "tie_points_per_photograph": per_photo,
            "image_sigma_px": sigma_px,
            "ground": "level",
            "attitudes": "straight down",
        },
        "expected": expected,
        "found": found,
        "ratio": {
            name: [
                None if one is None or two is None or not one > 0.0 else _round(two / one)
                for one, two in zip(values, found[name], strict=True)
            ]
            for name, values in expected.items()
        },
    }


def expected_finding(record: dict[str, Any] | None) -> list[str]:
    """What stands out, in words."""
    if record is None:
        return []
    words = {"centres_m": "centres", "rotations_deg": "rotations", "tie_points_m": "tie points"}
    out = []
    for name, text in words.items():
        worst = max((r for r in record["ratio"][name] if r is not None), default=0.0)
        if worst > _WORSE:
            axis = "xyz"[record["ratio"][name].index(worst)]
            out.append(f"{text} {axis} {worst:.1f} times")
    if not out:
        return []
    return ["less accurate than the plan of the flight let expect (standard deviations): " + ", ".join(out)]


def planned_network(result: BlockAdjustment, sigma_px: float, per_photo: int) -> Network:
    """The block as planned, its observations computed from it."""
    network = result.network
    centres = np.array(result.centres)
    if network.positions is not None:
        centres[network.positions.photo] = network.positions.xyz
    rotations = np.stack([_straight_down(r) for r in result.rotations])
    known = np.isfinite(result.points).all(axis=1)
    level = float(np.median(result.points[known, 2]))
    pattern = _pattern(result, centres, rotations, level, per_photo)
    control, names, given = _control(result, len(pattern))
    points = np.concatenate([pattern, given])
    names = [*(f"n{k}" for k in range(len(pattern))), *names]
    photo, point, xy = [], [], []
    for k, (centre, turn) in enumerate(zip(centres, rotations, strict=True)):
        camera = result.cameras[int(network.photographs.camera[k])]
        pixels, inside = camera.image_from_camera((points - centre) @ turn)
        seen = np.flatnonzero(inside)
        photo.append(np.full(len(seen), k))
        point.append(seen)
        xy.append(pixels[seen])
    photos, numbers, pixels = np.concatenate(photo), np.concatenate(point), np.concatenate(xy)
    count = np.bincount(numbers, minlength=len(points))
    keep = count[numbers] >= 2
    used = np.flatnonzero((count >= 2) | (np.arange(len(points)) >= len(pattern)))
    place = np.full(len(points), -1)
    place[used] = np.arange(len(used))
    keep &= place[numbers] >= 0
    if control is not None:
        control = replace(control, point=place[control.point])
    positions = network.positions
    if positions is not None:
        positions = replace(positions, xyz=centres[positions.photo])
    attitudes = network.attitudes
    if attitudes is not None:
        attitudes = replace(attitudes, rotations=rotations[attitudes.photo])
    cameras = tuple(
        replace(entry, camera=camera) for entry, camera in zip(network.cameras, result.cameras, strict=True)
    )
    return Network(
        cameras,
        Photographs(network.photographs.names, network.photographs.camera, centres, rotations),
        Points(tuple(names[k] for k in used.tolist()), points[used]),
        ImagePoints(
            photos[keep], place[numbers[keep]], pixels[keep], np.full((int(keep.sum()), 2), sigma_px)
        ),
        control,
        positions,
        attitudes,
    )


def _straight_down(rotation: Array) -> Array:
    """The same heading, no tilt."""
    heading = math.atan2(rotation[1, 0], rotation[0, 0])
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _pattern(
    result: BlockAdjustment, centres: Array, rotations: Array, level: float, per_photo: int
) -> Array:
    """Points of level ground in a square pattern, so many to a photograph."""
    low, high, areas = [], [], []
    for k, (centre, turn) in enumerate(zip(centres, rotations, strict=True)):
        camera = result.cameras[int(result.network.photographs.camera[k])]
        corners = camera.picture_px([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        rays = np.nan_to_num(camera.rays_from_image(corners)) @ turn.T
        ground = centre + rays * ((level - centre[2]) / rays[:, 2])[:, None]
        low.append(ground[:, :2].min(axis=0))
        high.append(ground[:, :2].max(axis=0))
        sides = np.linalg.norm(ground[[1, 3], :2] - ground[0, :2], axis=1)
        areas.append(float(sides.prod()))
    first, last = np.min(low, axis=0), np.max(high, axis=0)
    step = math.sqrt(float(np.median(areas)) / per_photo)
    x = np.arange(first[0] + step / 2.0, last[0], step)
    y = np.arange(first[1] + step / 2.0, last[1], step)
    plan = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.column_stack([plan, np.full(len(plan), level)])


def _control(result: BlockAdjustment, before: int) -> tuple[Control | None, list[str], Array]:
    """Control and check points where they are, counted after the pattern."""
    control = result.network.control
    if control is None:
        return None, [], np.empty((0, 3))
    place = np.array(result.points[control.point])
    known = np.isfinite(place).all(axis=1)
    assert control.check is not None  # filled in by the network
    names = [result.network.points.names[k] for k in control.point[known].tolist()]
    xyz = np.where(np.isfinite(control.sigma[known]), place[known], control.xyz[known])
    numbers = before + np.arange(int(known.sum()))
    return Control(numbers, xyz, control.sigma[known], None, control.check[known]), names, place[known]


def _figures(result: BlockAdjustment) -> dict[str, list[float | None]]:
    """Median standard deviations per axis of the tangent frame."""
    statistics = result.statistics
    assert statistics is not None  # asked before
    ties = np.ones(len(result.points), dtype=np.bool_)
    checks = np.zeros(len(result.points), dtype=np.bool_)
    control = result.network.control
    if control is not None:
        assert control.check is not None  # filled in by the network
        ties[control.point] = False
        checks[control.point[control.check]] = True
    return {
        "centres_m": _medians(statistics.photo_sigma[:, :3]),
        "rotations_deg": _medians(np.degrees(statistics.photo_sigma[:, 3:])),
        "tie_points_m": _medians(statistics.point_sigma[ties]),
        "check_points_m": _medians(statistics.point_sigma[checks]),
    }


def _medians(values: Array) -> list[float | None]:
    return [
        _round(float(np.median(known))) if (known := column[np.isfinite(column)]).size else None
        for column in values.T
    ]


def _round(value: float) -> float:
    """Rounded far below what matters, so that the last bits do not reach a file."""
    return float(f"{value:.8g}")
