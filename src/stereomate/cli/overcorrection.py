"""`stereomate overcorrection`: the factor of a section, its drawing, tables, and sections of a project."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereomate.cli.output import print_json

if TYPE_CHECKING:
    from stereomate.project.orientation_sections import PairGeometry
    from stereomate.relative.drawing import SectionDrawing
    from stereomate.relative.sections import OrientationSection, SectionStrength
    from stereomate.relative.tables import OverCorrectionTable


def register(app: typer.Typer) -> None:
    """Add the command and its subcommands to the application."""
    group = typer.Typer(rich_markup_mode=None)
    group.callback(invoke_without_command=True)(_overcorrection)
    group.command("table")(_table)
    group.command("section")(_project_section)
    app.add_typer(group, name="overcorrection")


def _overcorrection(
    context: typer.Context,
    point: Annotated[
        list[str] | None,
        typer.Option(
            "--point", metavar="Y,Z", help="Points 1, 3 and 5: y across, z below the centre, metres."
        ),
    ] = None,
    corrected: Annotated[
        int, typer.Option("--corrected", help="Number of the over-corrected point: 1, 3, 5, or 2, 4, 6.")
    ] = 5,
    profile: Annotated[
        Path | None, typer.Option("--profile", help="Terrain profile to draw: a text file with y,z lines.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option("--figure", help="Write the drawing: .svg, .pdf, .png, or .html with points to drag."),
    ] = None,
    scale: Annotated[
        float | None, typer.Option("--scale", help="Scale denominator of the drawing [default: a round one].")
    ] = None,
    construction: Annotated[
        bool, typer.Option("--construction", help="Draw a' and d' too, as in Kasper's Fig. 3.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Over-correction factor of a cross-section for von Gruber's relative orientation, on any terrain."""
    if context.invoked_subcommand is not None:
        return
    from stereomate.relative.drawing import section_drawing
    from stereomate.relative.sections import section_strength

    section = _section(point or [])
    strength = section_strength(section, corrected)
    drawing = section_drawing(section, corrected, None if profile is None else _profile(profile))
    if figure is not None:
        _write_drawing(drawing, figure, scale, construction)
    if json:
        print_json(_as_dict(strength, drawing))
    else:
        typer.echo(_as_text(strength, drawing))
        if figure is not None:
            typer.echo(f"wrote {figure}")


def _table(
    which: Annotated[
        str | None, typer.Argument(help="I (normal angle) or II (wide angle) [default: both].")
    ] = None,
    tangent: Annotated[
        str | None,
        typer.Option("--tangent", help="y/z of points 3 and 5, as 0.5 or 1/3: a table of your own."),
    ] = None,
    heights: Annotated[
        str, typer.Option("--heights", help="Heights over z1: FROM:TO:STEP, or a list with commas.")
    ] = "-0.2:0.2:0.05",
    heights_3: Annotated[
        str | None, typer.Option("--h3", help="Heights of point 3, where they differ from those of point 5.")
    ] = None,
    decimals: Annotated[int, typer.Option("--decimals", min=0, max=9, help="Decimals of the text.")] = 1,
    csv: Annotated[bool, typer.Option("--csv", help="Print comma-separated values.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Write a heat map: .svg, .pdf or .png (one table only).")
    ] = None,
) -> None:
    """Tables of over-correction factors: Kasper's I and II, or any other."""
    from stereomate.errors import InputError

    tables = _tables(which, tangent, heights, heights_3)
    if figure is not None:
        if len(tables) != 1:
            raise InputError("draws one table: say I or II, or give --tangent", field="--figure")
        from stereomate.report.overcorrection_style import save_figure
        from stereomate.report.overcorrection_tables import heat_map

        save_figure(heat_map(tables[0][1], tables[0][0]), figure)
    if json:
        print_json([{"title": title, **_table_dict(table)} for title, table in tables])
    elif csv:
        # One heading for all: the first column tells the tables apart.
        texts = [table.to_csv() for _, table in tables]
        typer.echo(texts[0] + "".join(text.split("\n", 1)[1] for text in texts[1:]), nl=False)
    else:
        typer.echo("\n\n".join(f"{title}\n{table.to_text(decimals)}" for title, table in tables))


def _project_section(
    project: Annotated[Path, typer.Argument(help="The project file.")],
    pair: Annotated[
        tuple[str, str] | None, typer.Option("--pair", metavar="LEFT RIGHT", help="One pair only.")
    ] = None,
    profiles: Annotated[
        int, typer.Option("--profiles", min=2, max=101, help="Cross-sections of each pair.")
    ] = 9,
    min_overlap: Annotated[
        float, typer.Option("--min-overlap", help="Least overlap of a pair, of the smaller footprint.")
    ] = 0.2,
    least_contrast: Annotated[
        float,
        typer.Option("--least-contrast", help="Least grey value contrast at a point; 0: no images read."),
    ] = 3.0,
    map_file: Annotated[Path | None, typer.Option("--map", help="Write a map: .svg, .pdf or .png.")] = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", help="Write a page (.html): map, table, drawings with points to drag."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Over-correction factors of every pair of a project, from cross-sections of its height model.

    Orientation points are von Gruber's where they are on land with texture, and others where they are not.
    Pairs near the critical circle are marked.
    """
    from stereomate.project import load
    from stereomate.project.orientation_sections import ProjectSectionOptions, project_sections

    options = ProjectSectionOptions(profiles=profiles, min_overlap=min_overlap, least_contrast=least_contrast)
    loaded = load(project)
    geometries = project_sections(loaded, options, pair)
    if map_file is not None:
        from stereomate.report.overcorrection_map import strength_map
        from stereomate.report.overcorrection_style import save_figure

        save_figure(strength_map(geometries, loaded.name), map_file)
    if report is not None:
        from stereomate.project.orientation_report import write_strength_report

        write_strength_report(report, loaded, geometries)
    if json:
        print_json([_geometry_dict(geometry) for geometry in geometries])
    else:
        for geometry in geometries:
            typer.echo(_geometry_text(geometry))
        weak = [geometry for geometry in geometries if geometry.verdict != "good"]
        typer.echo(f"{len(geometries)} pairs, {len(weak)} of them weak or near critical")


def _geometry_text(geometry: PairGeometry) -> str:
    sections = geometry.sections
    head = f"{geometry.names[0]} - {geometry.names[1]}: {geometry.verdict}; base {geometry.base_m:.1f} m, "
    head += f"height {geometry.height_m:.1f} m, n on flat ground {sections.flat_factor:.2f}, "
    lines = [head + f"strength {sections.strength:.2f}"]
    for section in sections.sections:
        lines.append(f"  at {section.place:6.3f} of the base  {_section_text(section)}")
    if sections.missing:
        places = ", ".join(f"{place:.3f}" for place in sections.missing)
        lines.append(f"  no three usable points at {places}")
    if geometry.from_previous is not None:
        lines.append(f"  from the model with {geometry.previous}  {_section_text(geometry.from_previous)}")
    return "\n".join(lines)


def _section_text(section: OrientationSection) -> str:
    strength = section.strength
    n = "±∞" if math.isinf(strength.factor) else f"{strength.factor:.2f}"
    marks: list[str] = [section.choice]
    marks += ["NEAR CRITICAL"] if section.near_critical else []
    marks += ["WEAK"] if section.weak else []
    points = "  ".join(f"({y:.0f}, {z:.0f})" for y, z in strength.section.tolist())
    return f"n {n:>7}  dn/dh {strength.change:.4f}/m  σω x{section.ratio:.2f}  {points}  {', '.join(marks)}"


def _geometry_dict(geometry: PairGeometry) -> dict[str, Any]:
    sections = geometry.sections
    return {
        "pair": geometry.names,
        "verdict": geometry.verdict,
        "base_m": geometry.base_m,
        "height_m": geometry.height_m,
        "nominal_tangent": geometry.nominal,
        "flat_factor": sections.flat_factor,
        "strength": sections.strength,
        "sections": [
            {**_section_dict(section), "points_map": points}
            for section, points in zip(sections.sections, geometry.points_map, strict=True)
        ],
        "missing": sections.missing,
        "previous": geometry.previous,
        "from_previous": None if geometry.from_previous is None else _section_dict(geometry.from_previous),
    }


def _section_dict(section: OrientationSection) -> dict[str, Any]:
    return {
        "place": section.place,
        "choice": section.choice,
        "n": section.strength.factor,
        "section": section.strength.section,
        "n_std_per_metre_of_height": section.strength.change,
        "omega_std_ratio": section.ratio,
        "near_critical": section.near_critical,
        "weak": section.weak,
    }


def _tables(
    which: str | None, tangent: str | None, heights: str, heights_3: str | None
) -> list[tuple[str, OverCorrectionTable]]:
    from stereomate.errors import InputError
    from stereomate.relative.tables import normal_angle_table, overcorrection_table, wide_angle_table

    if tangent is not None:
        if which is not None:
            raise InputError("must not stand with --tangent", field="table", value=which)
        columns = _heights(heights, "--heights")
        rows = columns if heights_3 is None else _heights(heights_3, "--h3")
        table = overcorrection_table(fraction(tangent, "--tangent"), rows[::-1], columns)
        return [(f"y/z = {tangent}", table)]
    known = {
        "I": ("Table I: normal-angle cameras, y/z = 1/3", normal_angle_table),
        "II": ("Table II: wide-angle cameras, y/z = 2/3", wide_angle_table),
    }
    if which is not None and which.upper() not in known:
        raise InputError("must be I or II", field="table", value=which)
    chosen = list(known) if which is None else [which.upper()]
    return [(known[name][0], known[name][1]()) for name in chosen]


def _section(points: list[str]) -> list[list[float]]:
    from stereomate.errors import InputError

    if len(points) != 3:
        raise InputError(
            "must be given three times, for points 1, 3 and 5", field="--point", value=len(points)
        )
    section = []
    for text in points:
        parts = text.split(",")
        if len(parts) != 2:
            raise InputError("must be Y,Z", field="--point", value=text)
        section.append([fraction(part, "--point") for part in parts])
    return section


def fraction(text: str, field: str) -> float:
    """A number, or a fraction such as 1/3."""
    from stereomate.errors import InputError

    try:
        parts = [float(part) for part in text.split("/")]
        value = parts[0] if len(parts) == 1 else parts[0] / parts[1]
    except (ValueError, ZeroDivisionError):
        value = math.nan
    if not math.isfinite(value) or text.count("/") > 1:
        raise InputError("must be a number or a fraction", field=field, value=text)
    return value


def _heights(text: str, field: str) -> list[float]:
    from stereomate.errors import InputError

    if ":" not in text:
        return [fraction(part, field) for part in text.split(",")]
    parts = text.split(":")
    if len(parts) != 3:
        raise InputError("must be FROM:TO:STEP", field=field, value=text)
    first, last, step = (fraction(part, field) for part in parts)
    if not (step > 0.0 and first <= last) or (last - first) / step > 200.0:
        raise InputError("must go up, in at most 200 steps", field=field, value=text)
    count = math.floor((last - first) / step + 1e-9) + 1
    # Decimal steps such as 0.05 add up to what they read as.
    return [round(first + index * step, 12) for index in range(count)]


def _profile(path: Path) -> list[list[float]]:
    from stereomate.errors import FormatError

    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError("must be a readable text file", file=path) from error
    values: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        parts = line.split("#")[0].replace(",", " ").split()
        if not parts:
            continue
        try:
            y, z = (float(part) for part in parts)
        except ValueError:
            if not values and number == 1:
                continue  # a heading
            raise FormatError("must hold y and z", file=path, field=f"line {number}", value=line) from None
        values.append([y, z])
    return values


def _write_drawing(drawing: SectionDrawing, path: Path, scale: float | None, construction: bool) -> None:
    if path.suffix.lower() == ".html":
        from stereomate.errors import StorageError
        from stereomate.report.overcorrection_interactive import interactive_page

        try:
            path.write_text(interactive_page(drawing), encoding="utf-8")
        except OSError as error:
            raise StorageError(f"{path}: cannot write the page ({error.strerror})") from error
        return
    from stereomate.report.overcorrection import draw_section
    from stereomate.report.overcorrection_style import save_figure

    save_figure(draw_section(drawing, scale, construction).figure, path)


def _as_dict(strength: SectionStrength, drawing: SectionDrawing) -> dict[str, Any]:
    circle = strength.circle
    return {
        "section": strength.section,
        "points": drawing.numbers,
        "corrected": strength.corrected,
        # JSON has no infinity: null here, and "critical" says it.
        "n": strength.factor,
        "critical": math.isinf(strength.factor),
        "d_m": strength.d,
        "a_m": strength.a,
        "n_read_off": drawing.factor,
        "critical_circle": {
            "centre_y_m": circle.centre_y,
            "centre_z_m": circle.centre_z,
            "radius_m": circle.radius,
            "side": strength.side,
            "distance_m": strength.distance,
        },
        "n_per_metre_of_height": strength.change_per_metre,
        "n_std_per_metre_of_height": strength.change,
        "omega_std_rad_per_metre_of_parallax": strength.tilt_std_per_metre,
        "omega_std_per_image_parallax_over_f": strength.tilt_std_per_angle,
    }


def _as_text(strength: SectionStrength, drawing: SectionDrawing) -> str:
    numbers, circle, point = drawing.numbers, strength.circle, strength.corrected
    critical = math.isinf(strength.factor)
    number = "±∞ (critical)" if critical else f"{strength.factor:.4f}"
    # Adding zero makes a plain zero of a negative one.
    centre = f"y = {round(circle.centre_y, 3) + 0.0:.3f} m, z = {circle.centre_z:.3f} m"
    away = "" if critical else f", {abs(strength.distance):.3f} m away"
    lines = [
        f"over-correction factor n at point {point}:  {number}",
        f"  read off the drawing, n = d/a:  d = {strength.d:.3f} m, a = {round(strength.a, 3) + 0.0:.3f} m",
        f"critical circle:  centre {centre}, radius {circle.radius:.3f} m",
        f"  point {point} is {strength.side} it{away}",
    ]
    if critical:
        return "\n".join([*lines, "the tilt ω is not determined by these three points"])
    changes = ", ".join(
        f"{change:+.5f} (point {number})"
        for number, change in zip(numbers, strength.change_per_metre, strict=True)
    )
    degrees = math.degrees(strength.tilt_std_per_metre)
    image = math.degrees(strength.tilt_std_per_angle) * 1e-3
    return "\n".join(
        [
            *lines,
            f"change of n per metre of height:  {changes}",
            f"  together, for independent errors of 1 m:  {strength.change:.5f}",
            f"standard deviation of ω per metre of y-parallax in the model:  {degrees:.6f}°",
            f"  per thousandth of the principal distance in the image:  {image:.6f}°",
        ]
    )


def _table_dict(table: OverCorrectionTable) -> dict[str, Any]:
    return {
        "tangent": table.tangent,
        "h3_over_z1": table.h3,
        "h5_over_z1": table.h5,
        "critical_sum": table.critical_sum,
        "n": table.factors,
    }
