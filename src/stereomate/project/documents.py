"""The documents beside the rasters of a run: STAC items and the report."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np

from stereomate.formats.stac import StacProduct, write_stac_item
from stereomate.frames.codes import epsg_code, wkt_of
from stereomate.frames.heights import HeightSystem
from stereomate.frames.mapframe import MapFrame
from stereomate.frames.transform import map_from_map
from stereomate.project.report import write_run_report
from stereomate.project.run import ProductResult, RunResult

WGS84 = "EPSG:4326"


def write_documents(result: RunResult, started: float) -> list[Path]:
    """Write a STAC item per product and the report; returns the files.

    Parameters
    ----------
    started : float
        `time.monotonic` at the start of the command, for the report.
    """
    now = dt.datetime.now(dt.UTC)
    written = []
    for made in result.products:
        name = made.product.job.name
        path = result.out / ("item.json" if not name else f"item_{name}.json")
        write_stac_item(path, _stac_product(result, made), now)
        written.append(path)
    return [*written, *write_run_report(result.out, result, started)]


def _stac_product(result: RunResult, made: ProductResult) -> StacProduct:
    job, files = made.product.job, made.product.files
    corners = np.column_stack([job.grid.corners()[::-1], np.zeros(4)])
    flat = MapFrame(job.frame.crs, HeightSystem.ellipsoidal())
    outline = map_from_map(MapFrame(WGS84, HeightSystem.ellipsoidal()), flat, corners)
    times = [p.time for p in job.photographs if p.time is not None]
    names = {"ortho": files.ortho, "lineage": files.lineage, "stereo": "stereo.json", "report": "report.html"}
    if files.mate is not None:
        names["mate"] = files.mate
    title = result.project.name or result.project.path.stem
    return StacProduct(
        identifier=title if not job.name else f"{title}-{job.name}",
        title=title,
        outline=tuple((float(lon), float(lat)) for lon, lat, _ in outline),
        epsg=epsg_code(job.frame.crs),
        wkt=wkt_of(job.frame.crs),
        shape=(job.grid.size[1], job.grid.size[0]),
        transform=job.grid.affine,
        gsd_m=job.grid.gsd * job.frame.unit_m,
        times=(min(times), max(times)) if len(times) == len(job.photographs) else None,
        files=names,
        hashes=files.hashes,
    )
