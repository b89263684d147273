"""`report.json`: what the report of a run says, for programs; its form is `report/report.schema.json`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from stereomate import __version__
from stereomate.errors import FormatError
from stereomate.forms import RUN_REPORT
from stereomate.raster.files import write_whole

# Whoever only reads a record loads none of these.
if TYPE_CHECKING:
    from stereomate.coverage.pairs import Pair
    from stereomate.project.accuracy_report import Judgement
    from stereomate.project.check_points import CheckPoints
    from stereomate.project.grid_effects import GridEffect
    from stereomate.project.homogeneity_report import Homogeneity
    from stereomate.project.run import ProductResult, RunResult
    from stereomate.stereo.agreement import ParallaxStatistics


@dataclass(frozen=True, eq=False)
class Findings:
    """What is found out for the report alone.

    Attributes
    ----------
    checked : CheckPoints or None
    judged : tuple of Judgement
    effects : tuple of GridEffect
    adjustment : mapping or None
        The record of the block adjustment behind the orientation, where one is known.
    homogeneity : tuple of Homogeneity
        Of each stereo product.
    not_modelled : tuple of str
    """

    checked: CheckPoints | None
    judged: tuple[Judgement, ...]
    effects: tuple[GridEffect, ...]
    adjustment: Mapping[str, Any] | None
    homogeneity: tuple[Homogeneity, ...]
    not_modelled: tuple[str, ...]


def run_record(result: RunResult, found: Findings, made: Mapping[str, Any]) -> dict[str, Any]:
    """The report as plain values.

    Parameters
    ----------
    made : mapping
        Command, seconds and peak memory: what differs between two runs of the same project.
    """
    project, coverage = result.project, result.coverage
    return {
        "format": RUN_REPORT.version,
        "kind": "stereomate report",
        "software": f"stereomate {__version__}",
        "made": dict(made),
        "key": result.key,
        "project": project.name or project.path.stem,
        "crs": project.frame.crs,
        "heights": project.frame.heights.description,
        "inputs": [{"role": i.role, "file": i.path.name, "sha256": i.digest} for i in project.inputs],
        "assumed": list(project.notes),
        "warnings": list(project.warnings),
        "left_out": [{"photograph": p.name, "reason": str(p.error)} for p in project.problems],
        "photographs": [
            {
                "name": f.name,
                "gsd_m": f.gsd_m,
                "height_above_ground_m": f.height_above_ground_m,
                "tilt_deg": f.tilt_deg,
                "covered": f.covered,
            }
            for f in coverage.known
        ],
        "pairs": [_pair(p, result) for p in coverage.pairs],
        "accuracy": {
            "requirements": [j.as_record() for j in found.judged],
            "check_points": None if found.checked is None else found.checked.as_record(),
        },
        "orientation": None if found.adjustment is None else orientation_part(found.adjustment),
        "homogeneity": [
            {"product": part.product, "object_heights": [s.as_record() for s in part.summaries]}
            for part in found.homogeneity
        ],
        "map_projection": [e.as_record() for e in found.effects],
        "products": [_product(product) for product in result.products],
        "not_modelled": list(found.not_modelled),
    }


def left_and_right(pair: Pair, result: RunResult) -> tuple[tuple[str, str], float]:
    """Left and right photograph of a pair as in the product it serves, and the azimuth of its base.

    A pair that is no model is ordered along the columns of the first product.
    """
    sides = {
        frozenset(names): names
        for made in result.products
        for job in (made.product.job,)
        for m in job.models
        if m.right >= 0 and (names := (job.photographs[m.left].name, job.photographs[m.right].name))
    }
    first, second = pair.names
    forward = pair.left_right(result.products[0].product.job.grid.rotation)[0] == pair.first
    names = sides.get(frozenset(pair.names), (first, second) if forward else (second, first))
    return names, pair.azimuth_deg if names[0] == first else (pair.azimuth_deg + 180.0) % 360.0


def _pair(pair: Pair, result: RunResult) -> dict[str, Any]:
    (left, right), azimuth = left_and_right(pair, result)
    return {
        "left": left,
        "right": right,
        "overlap": pair.overlap,
        "base_m": pair.base_m,
        "base_height": pair.base_height,
        "azimuth_deg": azimuth,
    }


# What the report of a run takes from adjustment.json.
_OF_ADJUSTMENT: Final = (
    "key",
    "frame",
    "summary",
    "findings",
    "cameras",
    "photographs",
    "not_oriented",
    "positions",
    "control",
    "y_parallaxes",
    "gross_errors",
)


def orientation_part(adjustment: Mapping[str, Any]) -> dict[str, Any]:
    """What the report holds of an adjustment.json."""
    return {key: adjustment[key] for key in _OF_ADJUSTMENT}


def write_run_record(path: Path, record: Mapping[str, Any]) -> None:
    """Write the record whole or not at all; NaN, which JSON does not know, becomes null."""
    text = json.dumps(_finite(record), indent=1, ensure_ascii=False, allow_nan=False)
    write_whole(path, [text.encode() + b"\n"])


def read_run_record(path: Path) -> dict[str, Any]:
    """Read a record of this form or an older one.

    Raises
    ------
    FormatError
        If it is no report, or was written by a newer stereomate.
    """
    try:
        record = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise FormatError("does not exist: stereomate run writes it", file=path) from None
    except (OSError, ValueError) as error:
        raise FormatError(f"cannot be read as JSON: {error}", file=path) from error
    if not isinstance(record, dict) or record.get("kind") != "stereomate report":
        raise FormatError("must be a report of stereomate", file=path, field="kind")
    return RUN_REPORT.migrated(record, path)


def _product(made: ProductResult) -> dict[str, Any]:
    job, files = made.product.job, made.product.files
    record: dict[str, Any] = {
        "name": job.name,
        "ortho": files.ortho,
        "mate": files.mate,
        "size": list(job.grid.size),
        "gsd": job.grid.gsd,
        "rotation_deg": math.degrees(job.grid.rotation),
        "hidden": job.options.hidden,
        "resampling": job.options.resampling,
        "law": None,
        "agreement": None,
        "sha256": dict(files.hashes),
    }
    if job.is_stereo:
        law = job.law
        record["law"] = {
            "kind": law.kind,
            "base_m": law.base_m,
            "w0_m": law.w0_m,
            "reference_m": law.reference_m,
        }
    if made.agreement is not None:
        record["agreement"] = {
            "ortho_ortho": _statistics(made.agreement.ortho_ortho),
            "ortho_mate_minus_law": _statistics(made.agreement.ortho_mate),
        }
    return record


def _statistics(s: ParallaxStatistics) -> dict[str, Any]:
    return {
        "matches": s.count,
        "median_px": list(s.median_px),
        "nmad_px": list(s.nmad_px),
        "largest_px": list(s.largest_px),
    }


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.item() if hasattr(value, "item") else value
