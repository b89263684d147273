"""The mosaic stage of a run: balance and seams of its products, seams edited by the user, and their file."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely

from stereomate.errors import FormatError
from stereomate.formats.seams import SeamRecord, read_seams, write_seams
from stereomate.frames.crs import same_crs
from stereomate.raster.files import storing, write_whole
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.mosaic import MosaicSummary, has_choice, needs_mosaic, plan_mosaics
from stereomate.rectify.radiometry import BalanceSummary, balance_from_record, balance_record
from stereomate.rectify.seampolygons import Polygons
from stereomate.rectify.seams import grained, seams_from_record, seams_record
from stereomate.stereo.product import read_document
from stereomate.stereo.record import path_from_record
from stereomate.tiles import Executor

# Gaps and overlaps of edited polygons up to this width (pixels) are taken for rounding.
SLIVER_PX: Final = 0.5

Planned = list[tuple[RectifyJob, MosaicSummary | None]]


def planned_mosaics(
    jobs: Sequence[RectifyJob], kept: Path, key: str, executor: Executor, edited: Path | None
) -> Planned:
    """The jobs with balance and seams; what an interrupted run of the same key found is taken over.

    Parameters
    ----------
    kept : Path
        File of the workspace in which the result lies until the run is finished.
    edited : Path or None
        Seams given by the user.

    Raises
    ------
    FormatError
        If the edited seams do not fit the products.
    """
    if not needs_mosaic(jobs):
        return [(job, None) for job in jobs]
    found = _kept(jobs, kept, key)
    if found is None:
        found = plan_mosaics(jobs, executor, None if edited is None else edited_polygons(edited, jobs))
        record = [
            {
                "seams": seams_record(job.seams),
                "balance": balance_record(job.balance),
                "summary": None if summary is None else dataclasses.asdict(summary),
            }
            for job, summary in found
        ]
        with storing(kept):
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_whole(kept, [json.dumps({"key": key, "products": record}).encode()])
    return found


def _kept(jobs: Sequence[RectifyJob], kept: Path, key: str) -> Planned | None:
    try:
        document: dict[str, Any] = json.loads(kept.read_bytes())
    except (OSError, ValueError):
        return None
    if document.get("key") != key:
        return None
    found: Planned = []
    for job, record in zip(jobs, document["products"], strict=True):
        seams, balance = seams_from_record(record["seams"]), balance_from_record(record["balance"])
        found.append((replace(job, seams=seams, balance=balance), summary_from_record(record["summary"])))
    return found


def summary_from_record(record: dict[str, Any] | None) -> MosaicSummary | None:
    """Inverse of `dataclasses.asdict` of a summary."""
    if record is None:
        return None
    values = dict(record)
    if values["balance"] is not None:
        inner: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in values["balance"].items()
        }
        values["balance"] = BalanceSummary(**inner)
    return MosaicSummary(**values)


def write_seam_file(path: Path, jobs: Sequence[RectifyJob]) -> bool:
    """Write the seams of all products that have some; says whether there were any."""
    records = []
    for job in jobs:
        if job.seams is None:
            continue
        names = [p.name for p in job.photographs]
        by_model: dict[int, list[shapely.Polygon]] = {}
        for number, polygon in job.seams.polygons:
            by_model.setdefault(number, []).append(shapely.transform(polygon, job.grid.map_from_pixel))
        for k in sorted(by_model):
            model = job.models[k]
            records.append(
                SeamRecord(
                    job.name,
                    names[model.left],
                    names[model.right] if model.right >= 0 else "",
                    shapely.MultiPolygon(by_model[k]),
                    base_height=float(np.hypot(model.base_u_m, model.base_v_m) / model.height_above_ground_m),
                )
            )
    if records:
        write_seams(path, records, jobs[0].frame.crs)
    return bool(records)


def edited_polygons(path: Path, jobs: Sequence[RectifyJob]) -> dict[str, Polygons]:
    """Seams of a file as polygons in product pixels, by name of the product.

    Raises
    ------
    FormatError
        If the file cannot be read, is in another CRS, names a product, photograph or model that is not there,
        or its polygons overlap or leave ground of a product uncovered.
    """
    records, crs = read_seams(path)
    if crs and not same_crs(crs, jobs[0].frame.crs):
        rule = f"must be in the CRS of the project, {jobs[0].frame.crs}"
        raise FormatError(rule, file=path, field="crs", value=crs)
    known = {job.name: job for job in jobs if has_choice(job)}
    for record in records:
        if record.product not in known:
            rule = f"must be one of the products with seams: {', '.join(repr(n) for n in known)}"
            raise FormatError(rule, file=path, field=f"feature {record.row}: product", value=record.product)
    return {
        name: _polygons_of(path, job, [r for r in records if r.product == name])
        for name, job in known.items()
        if any(r.product == name for r in records)
    }


def _polygons_of(path: Path, job: RectifyJob, records: list[SeamRecord]) -> Polygons:
    product = shapely.box(0, 0, *job.grid.size)
    found = []
    parts: list[tuple[int, shapely.Geometry]] = []
    for record in records:
        model = _model_of(path, job, record)
        pixels = shapely.transform(record.geometry, job.grid.pixel_from_map)
        parts.append((record.row, pixels))
        for part in shapely.get_parts(shapely.intersection(grained(pixels), product)):
            if isinstance(part, shapely.Polygon) and part.area > 0.0:
                found.append((model, grained(shapely.normalize(part))))
    _require_no_overlap(path, job, parts)
    _require_cover(path, job, product, [shape for _, shape in parts])
    return tuple(sorted(found, key=lambda item: (item[0], *item[1].bounds)))


def _model_of(path: Path, job: RectifyJob, record: SeamRecord) -> int:
    names = {photo.name: k for k, photo in enumerate(job.photographs)} | {"": -1}
    where = f"feature {record.row}"
    for side in ("left", "right"):
        name = getattr(record, side)
        if name not in names or (side == "left" and not name):
            rule = f"must name a photograph of the product: {', '.join(n for n in names if n)}"
            raise FormatError(rule, file=path, field=f"{where}: {side}", value=name)
    wanted = names[record.left], names[record.right]
    for k, model in enumerate(job.models):
        if (model.left, model.right) == wanted:
            return k
    hint = None
    if any((m.right, m.left) == wanted for m in job.models):
        hint = "left and right are exchanged"
    pairs = [
        (job.photographs[m.left].name, job.photographs[m.right].name) for m in job.models if m.right >= 0
    ]
    near = [f"{a} | {b}" for a, b in pairs if record.left in (a, b)]
    rule = f"must be a model of the product; with {record.left} there are {', '.join(near) or 'none'}"
    raise FormatError(rule, file=path, field=where, value=f"{record.left} | {record.right}", hint=hint)


def _require_no_overlap(path: Path, job: RectifyJob, parts: list[tuple[int, shapely.Geometry]]) -> None:
    tree = shapely.STRtree([shape for _, shape in parts])
    for k, (row, shape) in enumerate(parts):
        for other in sorted(int(i) for i in tree.query(shape)):
            if other <= k:
                continue
            common = shapely.intersection(shape, parts[other][1])
            if not shapely.buffer(common, -0.5 * SLIVER_PX).is_empty:
                where = f"feature {row} and feature {parts[other][0]}"
                raise FormatError("must not overlap", file=path, field=where, value=_place(job, common))


def _require_cover(
    path: Path, job: RectifyJob, product: shapely.Polygon, shapes: list[shapely.Geometry]
) -> None:
    missing = shapely.difference(product, shapely.union_all(shapes, grid_size=1.0 / 64.0))
    if shapely.buffer(missing, -0.5 * SLIVER_PX).is_empty:
        return
    rule = "must cover the whole product, without gaps"
    name = f"product {job.name}" if job.name else "seams"
    raise FormatError(rule, file=path, field=name, value=_place(job, missing))


def _place(job: RectifyJob, pixels: shapely.Geometry) -> str:
    """Size and place of something in product pixels."""
    parts = sorted(shapely.get_parts(pixels), key=lambda part: -part.area)
    x, y = job.grid.map_from_pixel(shapely.get_coordinates(shapely.point_on_surface(parts[0]))[0])
    area = float(pixels.area) * job.grid.gsd**2
    return f"{area:.1f} square map units, the largest part at {x:.2f}, {y:.2f}"


def sources_of(source: Path, out: Path | None) -> tuple[Path, Path, bool]:
    """Project file, folder of the products, and whether they are stereo, of a run's folder or a project file.

    Raises
    ------
    FormatError
        If the folder holds no run, or the run's project file is not where it was.
    """
    if source.is_file() and source.suffix == ".toml":
        if out is None:
            raise FormatError("must be given with a project file", file=source, field="--out")
        return source, out, True
    record = source / "stereo.json" if source.is_dir() else source
    document = read_document(record)
    written = document["run"].get("project_file")
    project = path_from_record(written, record.parent)
    if project is None or not project.is_file():
        raise FormatError(
            "was made from a project file that is not there any more",
            file=record,
            field="run.project_file",
            value=written,
            hint="give the project file itself, and --out",
        )
    stereo = any(product.get("law") is not None for product in document["products"])
    return project, out or record.parent, stereo
