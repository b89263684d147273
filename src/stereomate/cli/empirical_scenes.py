"""What `stereomate empirical` puts on the instrument: made-up models, tables of points, measured pairs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from stereomate.relative.empirical.measured import MeasuredPair
    from stereomate.relative.empirical.procedure import Procedure
    from stereomate.relative.empirical.projectors import PlotterModel, Setting


@dataclass(frozen=True)
class Scene:
    """The model, where it starts, and a cross-section if one is known; `given` is what to compare with."""

    model: PlotterModel
    start: Setting
    section: Any = None
    profiles: tuple[tuple[str, str, str], ...] = ()
    cleared_ratio: float = 1e-5
    given: Setting | None = None
    given_by: str = ""


@dataclass(frozen=True)
class Flight:
    """Size of a made-up model and how wrong its photographs are laid in."""

    flying_height: float
    base: float
    tilt_deg: float
    shift: float
    seed: int
    independent: bool

    def truth(self) -> Setting:
        """The orientation that the instrument has to find."""
        from stereomate.relative.empirical.scenes import wrong_orientation

        return wrong_orientation(
            self.base, self.seed, math.radians(self.tilt_deg), self.shift, self.independent
        )


def standard_scene(heights: str, tangent: str, flight: Flight, profiles: int, procedure: Procedure) -> Scene:
    """Six points at given heights, or several profiles through them."""
    import numpy as np

    from stereomate.cli.overcorrection import fraction
    from stereomate.relative.empirical.projectors import Setting
    from stereomate.relative.empirical.scenes import StandardTerrain, section_profiles

    terrain = StandardTerrain(
        heights=tuple(fraction(part, "--heights") for part in heights.split(",")),
        tangent=fraction(tangent, "--tangent"),
        flying_height=flight.flying_height,
        base=flight.base,
    )
    start, truth = Setting(flight.base), flight.truth()
    if profiles:
        places = np.linspace(0.0, 1.0, profiles).tolist() if profiles > 1 else [0.0]
        model, names = section_profiles(terrain, truth, places)
        return Scene(model, start, None, names)
    # The cross-section is known from a map: only that of standard points can be told here.
    under_right = procedure.section[0] == "2"
    standard = procedure.section in (("1", "3", "5"), ("2", "4", "6"))
    known = terrain.section(right=under_right) if standard else None
    return Scene(terrain.model(truth), start, known)


def project_scene(path: Path, pair: tuple[str, str] | None, profiles: int) -> Scene:
    """A pair of a project, its points chosen from cross-sections and measured by image matching."""
    from stereomate.errors import InputError
    from stereomate.project import load
    from stereomate.project.measured_pair import measured_pair

    if pair is None:
        raise InputError("is needed for a project: the names of two photographs", field="--pair")
    return _measured(measured_pair(load(path), pair), profiles, "the project")


def photographs_scene(
    files: tuple[Path, Path], camera: Path | None, scale: tuple[float | None, float], profiles: int
) -> Scene:
    """Two photographs, measured by image matching; `scale` is the base, if known, and the flying height."""
    from stereomate.cli.relative import grey_photograph, pair_of_files
    from stereomate.errors import InputError
    from stereomate.relative.automatic import orient_photographs
    from stereomate.relative.empirical.measured import Laying, measured_photographs

    if camera is None:
        raise InputError("is needed for two photographs", field="--camera")
    pair = pair_of_files(camera, str(files[0]), str(files[1]))
    left, right = (grey_photograph(file) for file in pair.files)
    result = orient_photographs(left, right, *pair.cameras)
    laying = Laying(profiles if profiles > 1 else 9, *scale)
    measured = measured_photographs(result, pair.cameras, pair.names, laying)
    return _measured(measured, profiles, "least squares over all matches")


def _measured(pair: MeasuredPair, profiles: int, given_by: str) -> Scene:
    if pair.failed:
        typer.echo(f"not matched, left out: {', '.join(pair.failed)}", err=True)
    return Scene(
        pair.model,
        pair.start,
        profiles=pair.profiles if profiles else (),
        # Parallaxes of less than a pixel belong to the measurement.
        cleared_ratio=pair.pixel,
        given=pair.given,
        given_by=given_by,
    )


def scene_of_table(path: Path, principal_distance: float | None, flight: Flight) -> Scene:
    """Image coordinates of both photographs, or ground points that are photographed first."""
    from stereomate.errors import InputError
    from stereomate.relative.empirical.projectors import (
        Setting,
        model_from_image_coordinates,
        model_from_points,
    )
    from stereomate.relative.measured_points import photo_coordinates
    from stereomate.relative.point_table import load_point_table

    table = load_point_table(path, ("image", "terrain"))
    start = Setting(flight.base)
    if table.kind == "image":
        if principal_distance is None:
            raise InputError("is needed for image coordinates", field="--principal-distance")
        left, right = photo_coordinates(table, path, (principal_distance, principal_distance))
        return Scene(model_from_image_coordinates(table.names, left, right, principal_distance), start)
    ground = table.values.copy()
    ground[:, 2] -= flight.flying_height
    return Scene(model_from_points(table.names, ground, flight.truth()), start)
