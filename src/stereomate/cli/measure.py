"""`stereomate measure`: exact points from positions measured in orthophoto and stereomate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereomate.cli.options import AngleSigma, CentreSigma
from stereomate.cli.output import console, print_json, table
from stereomate.cli.settings import Settings

if TYPE_CHECKING:
    from stereomate.stereo.measured import Measurement


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("measure")(_measure)


def _measure(
    context: typer.Context,
    product: Annotated[Path, typer.Argument(help="stereo.json of a run, or its folder.")],
    pairs: Annotated[
        Path,
        typer.Argument(help="CSV or GeoPackage: left_x, left_y, right_x, right_y, perhaps name."),
    ],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Write the points: .csv or .gpkg.")] = None,
    name: Annotated[str | None, typer.Option("--product", help="Which product of the run.")] = None,
    sigma_px: Annotated[
        float, typer.Option("--sigma-px", help="Standard deviation of each measured coordinate, pixels.")
    ] = 0.3,
    centre_sigma: CentreSigma = 0.0,
    angle_sigma: AngleSigma = 0.0,
    verify: Annotated[
        bool, typer.Option("--verify/--no-verify", help="Compare hashes of rasters and height model.")
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print points and summary as JSON.")] = False,
) -> None:
    """Easting, northing and height by intersection of the two rays, beside what the law alone reads."""
    import math

    from stereomate.formats.measured_pairs import read_measured_pairs, write_points
    from stereomate.stereo.measured import MeasureOptions
    from stereomate.stereo.product import StereoProduct

    settings: Settings = context.obj
    opened = StereoProduct.open(product, name, verify=verify)
    given = read_measured_pairs(pairs)
    options = MeasureOptions(sigma_px, centre_sigma, math.radians(angle_sigma))
    found = opened.measure(given.left, given.right, options)
    columns = _columns(given.names, opened, found)
    if out is not None:
        write_points(out, columns, found.points, opened.job.frame.crs)
    if as_json:
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        print_json({"points": rows, "summary": found.summary()})
    elif settings.verbosity >= 0:
        _print(columns, found, out)


def _columns(names: tuple[str, ...], product: Any, found: Measurement) -> dict[str, list[Any]]:
    photographs = [p.name for p in product.job.photographs]
    sigma = found.sigma

    def photograph(side: int) -> list[str]:
        return [photographs[k] if k >= 0 else "" for k in found.photographs[:, side].tolist()]

    return {
        "name": list(names),
        "easting": found.points[:, 0].tolist(),
        "northing": found.points[:, 1].tolist(),
        "height": found.points[:, 2].tolist(),
        "sigma_e": sigma[:, 0].tolist(),
        "sigma_n": sigma[:, 1].tolist(),
        "sigma_h": sigma[:, 2].tolist(),
        "sigma_h_orientation": (found.orientation_covariance[:, 2, 2] ** 0.5).tolist(),
        "law_height": found.law_heights.tolist(),
        "law_minus_exact": found.differences.tolist(),
        "y_parallax_m": found.y_parallax_m.tolist(),
        "miss_m": found.miss_m.tolist(),
        "left": photograph(0),
        "right": photograph(1),
        "flags": [" ".join(found.reasons(k)) for k in range(len(names))],
    }


def _print(columns: dict[str, list[Any]], found: Measurement, path: Path | None) -> None:
    shown = 40
    heads = ("name", "easting", "northing", "height", "σ h", "law - exact", "y-parallax", "miss", "flags")
    keys = (
        "name", "easting", "northing", "height", "sigma_h", "law_minus_exact", "y_parallax_m", "miss_m",
        "flags",
    )  # fmt: skip
    rows = [
        [value if isinstance(value, str) else f"{value:.3f}" for value in row]
        for row in zip(*(columns[key][:shown] for key in keys), strict=True)
    ]
    out = console()
    rest = max(0, len(columns["name"]) - shown)
    out.print(table("Measured points, metres", heads, rows, left=(0, 8), rest=rest))
    s = found.summary()
    accuracy = (
        f"Heights: σ {s['sigma_height_m']:.3f} m, {s['sigma_height_per_mille']:.2f} ‰ of the flying height "
        "(Blachut & van Wijk 1972: 0.3 ‰; Wang Mi 2004: 0.045 m on terrain, 0.067 m on roof corners)."
    )
    law = (
        f"Through the law alone they are off by {s['law_minus_exact_rms_m']:.2f} m rms, "
        f"{s['law_minus_exact_largest_m']:.2f} m at most."
    )
    count = f"{s['reliable']} of {s['points']} points reliable, {s['refused']} refused."
    miss = f"Rays miss each other by {s['miss_rms_m']:.3f} m rms."
    # the figures are those of reliable points
    for sentence in (count, accuracy, law, miss) if s["reliable"] else (count,):
        out.print(sentence, highlight=False)
    if path is not None:
        out.print(f"points: {path}")
