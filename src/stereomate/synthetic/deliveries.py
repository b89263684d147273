"""Deliveries without photographs: orientation, tie points and control as files, made in a known way.

What a surveyor gets from an aerial triangulation, with the truth known: in which frame it was adjusted, about
which axes and in which unit its angles are. For trying out audits and conversions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stereomate.camera.model import Camera
from stereomate.formats.declared import Declared
from stereomate.formats.ign import ImageObservations, write_mes
from stereomate.formats.orientation_set import OrientationSet, converted
from stereomate.formats.tables import write_table
from stereomate.formats.text_files import write_text
from stereomate.frames.adjusted import grid_from_space_centres
from stereomate.frames.attitude import AttitudeAxes
from stereomate.frames.prediction.plan import FlightPlan, SimulatedBlock, simulated_block
from stereomate.frames.transform import map_from_tangent
from stereomate.units import AngleUnit

_PROJECT = """[project]
crs = "{crs}"
heights = "ellipsoidal"

[[camera]]
name = "made"
size_px = [{size}, {size}]
principal_distance_px = {c:.6f}

[photos]
files = "*.tif"
orientation = "orientation.csv"

[control]
file = "control.app"

[observations]
files = "ties.mes"
"""


@dataclass(frozen=True)
class DeliveryOptions:
    """How a delivery was made.

    Attributes
    ----------
    in_grid : bool
        The block was adjusted in the map taken as Cartesian: its centres carry the scale of the grid.
    axes, unit : str
        Of the written angles.
    pixel_mm : float
    noise_px : float
        Standard deviation of the image observations.
    seed : int
    """

    in_grid: bool = False
    axes: AttitudeAxes = "grid"
    unit: AngleUnit = "deg"
    pixel_mm: float = 0.015
    noise_px: float = 0.3
    seed: int = 5


@dataclass(frozen=True, eq=False)
class Delivery:
    """A delivery and its truth.

    Attributes
    ----------
    project : Path
        Declares neither the axes nor the unit of the angles, nor how the block was adjusted.
    true : OrientationSet
        In the map, about grid axes, centres where they were.
    written : OrientationSet
        As the file has it.
    """

    project: Path
    true: OrientationSet
    written: OrientationSet


def write_delivery(folder: str | Path, plan: FlightPlan, options: DeliveryOptions | None = None) -> Delivery:
    """Photograph a plan's simulated block and write what an aerial triangulation would deliver.

    ``orientation.csv`` (a table without a word on its angles), ``ties.mes`` (image observations in pixels),
    ``control.app`` (true ellipsoidal heights) and ``project.toml``.

    Parameters
    ----------
    folder : path
        Made if it is not there.

    Raises
    ------
    StorageError
        If it cannot be written.
    """
    options = options or DeliveryOptions()
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    block = simulated_block(plan)
    names = tuple(f"photo_{k:02d}" for k in range(len(block.centres)))
    points = map_from_tangent(plan.tangent, plan.frame, block.points)
    tangent = OrientationSet(names, block.centres, block.rotations, plan.tangent, "tangent")
    true = converted(tangent, plan.frame, "grid")
    written = converted(true, plan.frame, options.axes)
    if options.in_grid:
        ground = float(points[block.control, 2].mean())
        centres = grid_from_space_centres(plan.frame, written.positions, ground)
        written = replace(written, positions=centres)
    _write_angles(folder / "orientation.csv", written, options)
    size = round(plan.format_mm / options.pixel_mm)
    write_mes(folder / "ties.mes", _observations(plan, block, names, size, options))
    control = [
        f"p{k} 13 {x:.4f} {y:.4f} {z:.4f}\n"
        for k, (x, y, z) in enumerate(points.tolist())
        if block.control[k]
    ]
    write_text(folder / "control.app", "".join(control))
    text = _PROJECT.format(crs=plan.crs, size=size, c=plan.principal_distance_mm / options.pixel_mm)
    write_text(folder / "project.toml", text)
    return Delivery(folder / "project.toml", true, written)


def _write_angles(path: Path, orientations: OrientationSet, options: DeliveryOptions) -> None:
    """The table as others write it: without the comments that say what its numbers are."""
    write_table(path, orientations, Declared(unit=options.unit))
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    write_text(path, "".join(line for line in lines if not line.startswith("#")))


def _observations(
    plan: FlightPlan, block: SimulatedBlock, names: tuple[str, ...], size: int, options: DeliveryOptions
) -> ImageObservations:
    """Pixels of all points, with noise."""
    c = plan.principal_distance_mm
    camera = Camera.from_pixel_pitch("made", (size, size), c, options.pixel_mm)
    directions = np.column_stack([block.xy / (1e-3 * c), -np.ones(len(block.xy))])
    pixels, _ = camera.image_from_camera(directions)
    pixels = pixels + np.random.default_rng(options.seed).normal(0.0, options.noise_px, pixels.shape)
    return ImageObservations(
        tuple(f"p{k}" for k in block.point_of), tuple(names[k] for k in block.photo_of), pixels
    )
