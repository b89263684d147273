"""Strips and what was found of navigation, as plain numbers and in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import pinvh
from scipy.stats import chi2

from stereomate.block.adjustment import BlockAdjustment
from stereomate.block.groups import NavigationGroups
from stereomate.block.open_datum import open_datum
from stereomate.block.shift_tests import ShiftTest
from stereomate.block.unknowns import vector_from_rotation
from stereomate.project.orient_control_record import number, numbers
from stereomate.project.orient_strips import StripShifts

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# A shift that could not be seen is worth a word from so many standard deviations of a position on.
_WEAK: Final = 10.0
# From so many on it is as good as not seen.
_NEVER: Final = 100.0


def strips_record(
    groups: NavigationGroups | None, photos: Integers, result: BlockAdjustment, shifts: StripShifts
) -> dict[str, Any] | None:
    """What `adjustment.json` holds under ``navigation``; None without positions and attitudes."""
    network = result.network
    if groups is None or (network.positions is None and network.attitudes is None):
        return None
    names = network.photographs.names
    strip = groups.strip[photos]
    order = np.argsort(groups.time[photos], kind="stable")
    return {
        "strips": [
            {"name": name, "photographs": [names[i] for i in order.tolist() if strip[i] == k]}
            for k, name in enumerate(groups.strip_names)
        ],
        "unknowns": _unknowns(result, groups.time_unit),
        "shift_tests": [_test_record(groups, test) for test in shifts.tests],
        "datum_open": list(open_datum(network, result.solution.defect)),
        "taken_as_shifted": [_test_record(groups, test) for test in shifts.shifted],
    }


def _name(groups: NavigationGroups, test: ShiftTest) -> str:
    names = groups.mount_names if test.kind == "mount" else groups.strip_names
    return "all" if test.kind == "all" else names[test.strip]


def _test_record(groups: NavigationGroups, test: ShiftTest) -> dict[str, Any]:
    return {
        "kind": test.kind,
        "strip": _name(groups, test),
        "positions": len(test.photo),
        "shift_m": numbers(test.shift),
        "standard_deviation_m": numbers(test.sigma),
        "statistic": number(test.statistic),
        "limit": number(test.limit),
        "significant": test.significant,
        "detectable_m": numbers(test.detectable),
        "not_told_from": [groups.strip_names[k] for k in test.alike],
    }


def _unknowns(result: BlockAdjustment, time_unit: str) -> list[dict[str, Any]]:
    """Shifts, drifts, lever arms and boresights that were found, each as three numbers."""
    statistics = result.statistics
    names = result.shared_names
    tests = result.options.tests
    turns = result.solution.prepared.layout.boresight
    found = []
    for k in range(len(names) - 2):
        if not names[k].endswith(" x") or not names[k + 2].endswith(" z"):
            continue
        label = names[k][:-2]
        values = result.shared[k : k + 3]
        if k in turns:
            values = _boresight(result, int(np.flatnonzero(turns == k)[0]))
        prior = result.solution.prepared.layout.prior_sigma[k : k + 3]
        entry: dict[str, Any] = {
            "what": label,
            "unit": "rad" if k in turns else "m" if "drift" not in label else f"m/{time_unit}",
            "value": numbers(values),
            "prior": numbers(prior),
            "standard_deviation": None,
            "statistic": None,
            "limit": None,
            "significant": None,
            "not_separable_from": _not_separable(result, label),
        }
        if statistics is not None:
            covariance = statistics.scale**2 * statistics.cofactors.shared[k : k + 3, k : k + 3]
            statistic = float(values @ pinvh(covariance) @ values)
            limit = float(chi2.isf(tests.alpha, 3))
            entry |= {
                "standard_deviation": numbers(np.sqrt(np.diag(covariance))),
                "statistic": number(statistic),
                "limit": number(limit),
                "significant": statistic > limit,
            }
        found.append(entry)
    return found


def _not_separable(result: BlockAdjustment, label: str) -> list[dict[str, Any]]:
    """Other unknowns whose correlation with one of these is over 95 %."""
    found = []
    for entry in result.correlations:
        pair = [entry.first, entry.second]
        own = [name for name in pair if name.startswith(label + " ")]
        if len(own) == 1:
            (other,) = (name for name in pair if name != own[0])
            found.append({"own": own[0], "other": other, "correlation": number(entry.value)})
    return found


def _boresight(result: BlockAdjustment, mount: int) -> Array:
    return vector_from_rotation(result.solution.state.boresight[mount])


def strip_findings(record: dict[str, Any] | None, sigma_m: Sequence[float]) -> list[str]:
    """What a reader must know of the strips."""
    if record is None:
        return []
    lines = []
    free = [u["what"] for u in record["unknowns"] if "shift" in u["what"] and None in u["prior"]]
    if record["datum_open"] and free:
        lines.append(
            f"the shifts of {len(free)} strips have no prior and nothing else tells the place of the block: "
            f"{', '.join(record['datum_open'])} cannot be told from them and are as the start has them; "
            "control points, or standard deviations in orient.strip_shift_sigma_m, would hold the datum"
        )
    members = {entry["name"]: entry["photographs"] for entry in record["strips"]}
    for test in record["taken_as_shifted"]:
        size = ", ".join("-" if v is None else f"{v:+.3f}" for v in test["shift_m"])
        if test["kind"] == "mount" and not test["not_told_from"]:
            lines.append(
                f"positions of all photographs of {test['strip']} are off by {_with_sigma(test)} m along the "
                "axes of the camera (x right, y up, z back), to opposite sides in strips flown there and "
                "back: a lever arm (orient.lever_arm_m), a principal point, or parameters of the lens that "
                "are found while the principal point is held; what shows of it was found with the block"
            )
            continue
        if test["not_told_from"]:
            others = [*([test["strip"]] if test["kind"] == "strip" else []), *test["not_told_from"]]
            axes = "along the axes of the camera" if test["kind"] == "mount" else "east, north, up"
            lines.append(
                f"positions of strips {', '.join(others)} contradict each other by "
                f"{_with_sigma(test)} m ({axes}): nothing in the block tells which of them is shifted, or "
                "whether the camera is off (a lever arm, a principal point, a lens found while that is "
                "held); each strip got a shift of its own, as uncertain as the contradiction is large"
            )
            continue
        photos = members[test["strip"]]
        lines.append(
            f"positions of strip {test['strip']} ({photos[0]} to {photos[-1]}) are shifted as a whole "
            f"against the rest by {size} m (east, north, up); its shift was found with the block, "
            "orient.strip_shift_sigma_m does so for all strips"
        )
    for test in record["shift_tests"]:
        if test["significant"] and test["kind"] == "strip":
            size = ", ".join("-" if v is None else f"{v:+.3f}" for v in test["shift_m"])
            lines.append(
                f"positions of strip {test['strip']}: a shift of {size} m (east, north, up) fits the block "
                f"better (test {test['statistic']:.1f}, limit {test['limit']:.1f})"
            )
    return lines + _unseen(record, sigma_m)


def _with_sigma(test: dict[str, Any]) -> str:
    return ", ".join(
        "-" if v is None or s is None else f"{v:+.3f} ± {s:.3f}"
        for v, s in zip(test["shift_m"], test["standard_deviation_m"], strict=True)
    )


def _unseen(record: dict[str, Any], sigma_m: Sequence[float]) -> list[str]:
    """Shifts of a strip that this block could not have shown."""
    weak = []
    for test in record["shift_tests"]:
        if test["kind"] != "strip":
            continue
        sizes = test["detectable_m"]
        if any(v is None or v > _WEAK * s for v, s in zip(sizes, sigma_m, strict=True)):
            never = [v is None or v > _NEVER * s for v, s in zip(sizes, sigma_m, strict=True)]
            words = ["not at all" if no else f"{v:.2f}" for v, no in zip(sizes, never, strict=True)]
            weak.append(f"strip {test['strip']} {'not at all' if all(never) else ', '.join(words)}")
    if not weak:
        return []
    text = (
        "a weak block: a shift of the positions of one strip would be seen only from these sizes on (east, "
        f"north, up, m): {'; '.join(weak)}"
    )
    if "not at all" in text:
        text += f"; not at all: not even {_NEVER:.0f} standard deviations of a position would be"
    return [text]
