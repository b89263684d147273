"""A commented project file drafted from what lies in a folder of photographs: what `init` writes."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from stereomate.errors import ProjectError
from stereomate.forms import PROJECT
from stereomate.project.draft_cameras import camera_sections
from stereomate.project.findings import Findings, FoundPhoto, look_through, photo_pattern
from stereomate.raster.files import write_whole

PROJECT_FILE: Final = "project.toml"
EXIF_TABLE: Final = "orientation_exif.csv"


@dataclass(frozen=True)
class Draft:
    """A drafted project.

    Attributes
    ----------
    text : str
        The project file.
    files : mapping of name to text
        Tables to write beside it.
    to_do : tuple of str
        What the user has to fill in or to decide.
    """

    folder: Path
    text: str
    tables: tuple[tuple[str, str], ...]
    to_do: tuple[str, ...]


def draft_project(folder: Path) -> Draft:
    """Draft a project from a folder.

    Raises
    ------
    ProjectError
        If the folder is missing or holds no photograph.
    """
    found = look_through(folder)
    to_do: list[str] = []
    tables: list[tuple[str, str]] = []
    sections = [
        _project_section(found, to_do),
        *camera_sections(found, to_do),
        _photos_section(found, tables, to_do),
        _terrain_section(found, to_do),
        _PRODUCTS,
    ]
    return Draft(folder, "\n".join(sections), tuple(tables), tuple(to_do))


def write_draft(draft: Draft, path: Path, *, force: bool = False) -> tuple[Path, ...]:
    """Write a draft, whole or not at all; the files that were written.

    Raises
    ------
    ProjectError
        If a file is there already and `force` is not set.
    StorageError
        If the place cannot be written.
    """
    texts = [(path.parent / name, text) for name, text in draft.tables] + [(path, draft.text)]
    for target, _ in texts:
        if target.exists() and not force:
            raise ProjectError("is there already", file=target, hint="--force writes over it")
    for target, text in texts:
        write_whole(target, [text.encode()])
    return tuple(target for target, _ in texts)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _project_section(found: Findings, to_do: list[str]) -> str:
    name = found.folder.resolve().name
    if found.crs is None:
        crs = '# crs = "EPSG:..."                # the map projection of the project'
        to_do.append("project.crs: no file says which map projection to use")
    else:
        text = found.crs.text
        written = f"'''{text}'''" if "\n" in text or '"' in text else _quoted(text)
        crs = f"crs = {written}   # from {found.crs.source}"
    vertical = next(
        (f"; {info.path.name} names {v}" for info in found.surfaces if (v := _vertical(info.crs_wkt))), ""
    )
    return f"""# Drafted by stereomate init. Every key is described in docs/project_file.md;
# `stereomate check` says what is missing or doubtful.

[project]
format = {PROJECT.version}
name = {_quoted(name)}
{crs}
# What all heights mean: "ellipsoidal", a vertical CRS ("EPSG:5773"), or a geoid grid file; [photos],
# [terrain] and [control] may say their own. "undeclared": one unknown common system, taken as it
# is{vertical}.
heights = "undeclared"
"""


def _vertical(wkt: str) -> str:
    from stereomate.frames.heights import HeightSystem
    from stereomate.frames.mapframe import MapFrame

    return MapFrame(wkt, HeightSystem.undeclared()).vertical_name or "" if wkt else ""


def _photos_section(found: Findings, tables: list[tuple[str, str]], to_do: list[str]) -> str:
    pattern = photo_pattern(found.photographs, found.folder)
    files = f"files = {json.dumps(pattern, ensure_ascii=False)}   # {len(found.photographs)} photographs"
    body = _orientation_lines(found, tables, to_do)
    others = [photo.path.name for photo in found.others]
    left_out = [f"# Without orientation, left out: {', '.join(others[:10])}"] if others else []
    return "\n".join(["[photos]", files, *left_out, *body, ""])


def _orientation_lines(found: Findings, tables: list[tuple[str, str]], to_do: list[str]) -> list[str]:
    if found.tables:
        lines = _table_lines(found, 0)
        for index in range(1, min(len(found.tables), 2)):
            lines += [
                "",
                "# Another orientation of the same photographs: check says how far apart the two are.",
            ]
            lines += ["[photos.compare]", *_table_lines(found, index, comment=False)]
        return lines
    if found.reconstructions:
        path = found.reconstructions[0].path.relative_to(found.folder).as_posix()
        return [
            f"orientation = {_quoted(path)}",
            '# opensfm_frame = "projected"     # or "topocentric"; absent: told from the data',
        ]
    if found.has_positions:
        tables.append((EXIF_TABLE, _exif_table(found.photographs)))
        if any(photo.tags.gimbal is None for photo in found.photographs):
            to_do.append(f"{EXIF_TABLE}: some photographs carry no angles; fill in roll, pitch, yaw")
        to_do.append("photos.orientation: of EXIF, good to metres; stereomate orient finds a better one")
        return [
            f"orientation = {_quoted(EXIF_TABLE)}   # from EXIF and XMP: good to metres",
            'crs = "EPSG:4326"',
            'angles = "rph"                       # roll, pitch, heading from true north, image top forward',
            "# Altitudes of drones are mostly ellipsoidal though EXIF calls them heights above sea level.",
        ]
    to_do.append(
        "photos.orientation: neither a table of orientations nor positions in the photographs were found"
    )
    return ['# orientation = "orientation.csv"   # filename, x, y, z, omega, phi, kappa']


def _table_lines(found: Findings, index: int, comment: bool = True) -> list[str]:
    entry = found.tables[index]
    table = entry.table
    path = table.path.relative_to(found.folder).as_posix()
    lines = [f"orientation = {_quoted(path)}   # {', '.join(table.columns)}"]
    if entry.columns is not None:
        lines.append(f"columns = {json.dumps(list(entry.columns))}   # guessed: the file has no header")
    if not table.has(("x", "y", "z")):
        lines.append('crs = "EPSG:4326"                    # of longitude and latitude')
    if table.has(("omega", "phi", "kappa")):
        lines.append(
            'angles = "grid"                      # axes: "grid", "local" (ENU at each centre), "tangent"'
        )
        if comment:
            lines += [
                "# Centres are from an adjustment in the map grid, whose scale their heights carry",
                "# (grid), or true positions (space). check says whether it matters.",
                '# adjusted_in = "grid"',
            ]
    else:
        lines.append(
            'angles = "rph"                       # roll, pitch, heading from true north, image top forward'
        )
    return lines


def _exif_table(photographs: Sequence[FoundPhoto]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["filename", "longitude", "latitude", "altitude", "roll", "pitch", "yaw", "camera"])
    for photo in photographs:
        tags = photo.tags
        angles = ["", "", ""]
        if tags.gimbal is not None:
            values = (tags.gimbal.roll_deg, tags.gimbal.pitch_deg, tags.gimbal.heading_deg)
            angles = [f"{value:g}" for value in values]
        altitude = "" if tags.altitude is None else f"{tags.altitude:.3f}"
        position = [f"{tags.longitude:.8f}", f"{tags.latitude:.8f}", altitude]
        writer.writerow([photo.path.name, *position, *angles, tags.model])
    return out.getvalue()


def _terrain_section(found: Findings, to_do: list[str]) -> str:
    if found.surfaces:
        path = found.surfaces[0].path.relative_to(found.folder).as_posix()
        others = [info.path.relative_to(found.folder).as_posix() for info in found.surfaces[1:]]
        also = f"\n# Also here: {', '.join(others)}" if others else ""
        return f"[terrain]\nfile = {_quoted(path)}{also}\n"
    level = _level_below(found)
    if level is not None:
        to_do.append("terrain: no height model was found; level ground at the place of take-off stands in")
        return (
            "[terrain]\n"
            '# file = "heights.tif"               # a height model; without one, level ground:\n'
            f"level = {level:.1f}                         # altitude minus height above take-off, mean\n"
            "stand_in = true                      # until stereomate orient and run make their own surface\n"
        )
    to_do.append("terrain.file: no height model was found")
    return '# [terrain]\n# file = "heights.tif"\n'


def _level_below(found: Findings) -> float | None:
    levels = [
        photo.tags.altitude - photo.tags.height_above_start
        for photo in found.photographs
        if photo.tags.altitude is not None and photo.tags.height_above_start is not None
    ]
    return sum(levels) / len(levels) if levels else None


_PRODUCTS: Final = """[products]
# gsd = 0.1                          # absent: the median GSD of the photographs
law = "logarithmic"                  # or "linear", "natural"
# hidden = "fill"                    # ground a photograph does not see: "nodata", "fill", "keep"
# resampling = "cubic"               # "nearest", "bilinear", "cubic", "lanczos"
# rotation = "auto"                  # rows along the base where needed; "north-up", or degrees
# bounds = [x_min, y_min, x_max, y_max]
# area = "area.gpkg"                 # polygons of interest
# compression = "zstd"               # "deflate", "jpeg", "webp"
"""
