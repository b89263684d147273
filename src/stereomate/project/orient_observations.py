"""Tables of an orientation: every observation that is not an image point, the whole covariance."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.adjustment import BlockAdjustment
from stereomate.block.influence import influences
from stereomate.block.reliability import Reliability
from stereomate.block.whole import full_covariance
from stereomate.formats.parquet import write_parquet

Array = NDArray[np.float64]

OBSERVATIONS: Final = "observations.parquet"
WHOLE: Final = "full_covariance.parquet"

_AXES: Final = ("x", "y", "z")
_PHOTO: Final = ("X0", "Y0", "Z0", "rotation x", "rotation y", "rotation z")
_MEANINGS: Final = {
    "kind": "control, check, position, attitude, or prior of a parameter",
    "of": "point, photograph or parameter",
    "axis": "of the tangent frame; empty for parameters",
    "unit": "of all numbers of the row but the last two",
    "used": "took part in the adjustment",
    "residual": "observed minus adjusted",
    "sigma": "standard deviation as it was stated",
    "redundancy": "redundancy number, 0 to 1",
    "standardized": "residual over its standard deviation",
    "detectable": "minimal detectable error",
    "own_shift": "motion of the own point, projection centre (metres) or parameter (its unit) by the "
    "minimal detectable error",
    "own_turn_deg": "turn of the own photograph by the minimal detectable error, degrees",
}


def write_observations(path: Path, result: BlockAdjustment) -> Path:
    """Write every observation that is not an image point, one coordinate in a row."""
    rows: dict[str, list[Any]] = {name: [] for name in _MEANINGS}
    statistics, network = result.statistics, result.network
    if statistics is not None:
        effect = influences(result)
        control = network.control
        if control is not None and statistics.control is not None:
            assert control.check is not None  # filled in by the network
            names = [network.points.names[j] for j in control.point.tolist()]
            kinds = np.where(control.check, "check", "control").tolist()
            _add(rows, kinds, names, statistics.control, effect.control, None, "m")
        for kind, part, own in (
            ("position", "positions", effect.positions),
            ("attitude", "attitudes", effect.attitudes),
        ):
            reliability, observed = getattr(statistics, part), getattr(network, part)
            if reliability is None or observed is None:
                continue
            names = [network.photographs.names[k] for k in observed.photo.tolist()]
            turn = np.degrees(own[:, :, 1])
            unit = "m" if kind == "position" else "rad"
            _add(rows, [kind] * len(names), names, reliability, own[:, :, 0], turn, unit)
        known = np.flatnonzero(np.isfinite(statistics.priors.sigma[:, 0]))
        for k in known.tolist():
            name = result.shared_names[k]
            _row(
                rows, ("prior", name, "", _unit(name)), statistics.priors, (k, 0), effect.priors[k], math.nan
            )
    for name in (
        "residual",
        "sigma",
        "redundancy",
        "standardized",
        "detectable",
        "own_shift",
        "own_turn_deg",
    ):
        rows[name] = np.array(rows[name], dtype=np.float64)  # type: ignore[assignment]
    rows["used"] = np.array(rows["used"], dtype=np.bool_)  # type: ignore[assignment]
    write_parquet(path, rows, _MEANINGS)
    return path


def _unit(name: str) -> str:
    if name.startswith("boresight"):
        return "rad"
    if "shift" in name or name.startswith("lever arm"):
        return "m"
    return "m in a unit of time" if "drift" in name else "of the parameter"


def _add(
    rows: dict[str, list[Any]],
    kinds: list[str],
    names: list[str],
    part: Reliability,
    own: Array,
    turn: Array | None,
    unit: str,
) -> None:
    for k, (kind, name) in enumerate(zip(kinds, names, strict=True)):
        for a, axis in enumerate(_AXES):
            if np.isfinite(part.residuals[k, a]):
                last = math.nan if turn is None else float(turn[k, a])
                _row(rows, (kind, name, axis, unit), part, (k, a), float(own[k, a]), last)


def _row(
    rows: dict[str, list[Any]],
    labels: tuple[str, str, str, str],
    part: Reliability,
    at: tuple[int, int],
    own: float,
    turn: float,
) -> None:
    for name, label in zip(("kind", "of", "axis", "unit"), labels, strict=True):
        rows[name].append(label)
    rows["used"].append(bool(np.isfinite(part.redundancy[at])))
    rows["residual"].append(part.residuals[at])
    rows["sigma"].append(part.sigma[at])
    rows["redundancy"].append(part.redundancy[at])
    rows["standardized"].append(part.standardized[at])
    rows["detectable"].append(part.minimal_detectable[at])
    rows["own_shift"].append(own)
    rows["own_turn_deg"].append(turn)


def write_whole_covariance(path: Path, result: BlockAdjustment) -> Path:
    """Write the covariance of all photographs and shared unknowns, a column for each unknown.

    Centres in metres, rotations about the tangent axes in radians; of free networks by minimal constraints.
    """
    scale = 1.0 if result.statistics is None else result.statistics.scale
    matrix = scale**2 * full_covariance(result.solution)
    names = [f"{photo}: {what}" for photo in result.network.photographs.names for what in _PHOTO]
    names += result.shared_names
    columns: dict[str, Any] = {"unknown": names}
    columns |= {name: matrix[:, k] for k, name in enumerate(names)}
    write_parquet(path, columns, {"unknown": "of the row; the columns are in the same order"})
    return path
