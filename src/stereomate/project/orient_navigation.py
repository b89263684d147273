"""Strips and mounts of a block: which photographs share shifts, drifts, lever arms and boresights."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stereomate.block.groups import NavigationGroups
from stereomate.coverage.strips import flight_order, flight_strips
from stereomate.errors import ProjectError
from stereomate.project.orient_inputs import OrientInputs
from stereomate.project.orient_photos import RawPhoto
from stereomate.project.photos import is_excluded

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


def navigation_groups(inputs: OrientInputs) -> NavigationGroups:
    """The groups that a project states, or those that its flight shows.

    Raises
    ------
    ProjectError
        If a group names no photograph, one of another group too, or a lever arm no mount.
    """
    orient, photos = inputs.file.orient, inputs.photos
    times = np.array([math.nan if p.tags.time is None else p.tags.time for p in photos])
    if orient.strips == "auto":
        strip = flight_strips([p.name for p in photos], inputs.positions.tangent, times)
        strip_names = tuple(str(k + 1) for k in range(int(strip.max(initial=-1)) + 1))
    else:
        strip, strip_names = _stated(inputs.path, "orient.strips", orient.strips, photos)
    mount, mount_names = _mounts(inputs)
    time, unit = _times(photos, times, strip)
    sigma = orient.boresight_sigma_deg
    return NavigationGroups(
        strip,
        strip_names,
        time,
        unit,
        _prior(orient.strip_shift_sigma_m),
        _prior(orient.strip_drift_sigma_m),
        mount,
        mount_names,
        _lever_arms(inputs, mount_names),
        orient.lever_arm_sigma_m,
        math.inf if sigma == "free" else math.radians(sigma),
    )


def _prior(stated: Literal["free"] | tuple[float, float, float] | None) -> tuple[float, float, float] | None:
    return (math.inf,) * 3 if stated == "free" else stated


def _stated(
    path: Path, field: str, groups: Mapping[str, Sequence[str]], photos: Sequence[RawPhoto]
) -> tuple[Integers, tuple[str, ...]]:
    """Group of each photograph by the patterns of its name; -1 for those of none."""
    number = np.full(len(photos), -1, dtype=np.int64)
    for k, (name, patterns) in enumerate(groups.items()):
        mine = [
            row
            for row, photo in enumerate(photos)
            if any(is_excluded(photo.path, pattern) or photo.name == pattern for pattern in patterns)
        ]
        if not mine:
            raise ProjectError("must name photographs of the project", file=path, field=f"{field}.{name}")
        for row in mine:
            if number[row] >= 0:
                rule = f"must not name a photograph of {list(groups)[number[row]]} too"
                raise ProjectError(rule, file=path, field=f"{field}.{name}", value=photos[row].name)
            number[row] = k
    return number, tuple(groups)


def _mounts(inputs: OrientInputs) -> tuple[Integers, tuple[str, ...]]:
    mounts, photos = inputs.file.orient.mounts, inputs.photos
    if mounts == "one":
        return np.zeros(len(photos), np.int64), ("all",)
    if mounts == "camera":
        names = tuple(dict.fromkeys(photo.camera.name for photo in photos))
        place = {name: k for k, name in enumerate(names)}
        return np.array([place[photo.camera.name] for photo in photos], dtype=np.int64), names
    number, names = _stated(inputs.path, "orient.mounts", mounts, photos)
    missing = [photo.name for photo, k in zip(photos, number.tolist(), strict=True) if k < 0]
    if missing:
        rule = "must name every photograph in one of its groups; missing"
        raise ProjectError(rule, file=inputs.path, field="orient.mounts", value=missing[0])
    return number, names


def _lever_arms(inputs: OrientInputs, names: tuple[str, ...]) -> Array:
    stated = inputs.file.orient.lever_arm_m
    if not isinstance(stated, dict):
        return np.array([stated] * max(len(names), 1), dtype=np.float64)
    for name in (*stated, *names):
        if name not in names or name not in stated:
            rule = f"must state the lever arm of each mount and no other: {', '.join(names)}"
            raise ProjectError(rule, file=inputs.path, field="orient.lever_arm_m", value=name)
    return np.array([stated[name] for name in names], dtype=np.float64)


def _times(photos: Sequence[RawPhoto], times: Array, strip: Integers) -> tuple[Array, str]:
    """Times for drifts: seconds if all of a strip differ, else the number of the photograph in its strip."""
    number = np.zeros(len(photos))
    seconds = True
    for k in range(int(strip.max(initial=-1)) + 1):
        rows = np.flatnonzero(strip == k)
        order = flight_order([photos[row].name for row in rows.tolist()], times[rows])
        number[rows[order]] = np.arange(len(rows))
        seconds &= bool(np.isfinite(times[rows]).all()) and len(np.unique(times[rows])) == len(rows)
    if not seconds:
        return number, "photograph"
    start = float(np.nanmin(times)) if np.isfinite(times).any() else 0.0
    return np.nan_to_num(times - start), "s"
