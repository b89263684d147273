"""What the parameters of cameras that an adjustment found are worth."""

from __future__ import annotations

import math
from typing import Any, Final

from scipy.stats import norm

from stereomate.block.adjustment import BlockAdjustment
from stereomate.camera.model import EBNER_NAMES
from stereomate.project.orient_control_record import number

_TWELVE: Final = frozenset(EBNER_NAMES)
# Above this share of the variance of its prior a parameter is the prior's, and there is nothing to test.
_PRIORS_OWN: Final = 0.98


def camera_records(result: BlockAdjustment, significance: float) -> list[dict[str, Any]]:
    """Parameters of all cameras with their accuracy, and whether those found differ from what was known.

    The test is of what the observations alone say against the value before: normal, two-sided.
    """
    limit = float(norm.ppf(1.0 - significance / 2.0))
    place = {name: k for k, name in enumerate(result.shared_names)}
    cameras: list[dict[str, Any]] = []
    for entry, camera in zip(result.network.cameras, result.cameras, strict=True):
        parameters = {}
        start = dict(zip(entry.camera.parameter_names, entry.camera.parameters, strict=True))
        for name, value in zip(camera.parameter_names, camera.parameters, strict=True):
            k = place.get(f"{camera.name}: {name}")
            prior = entry.free.get(name, math.nan)
            t = math.nan if k is None else _test(result, k, value - start[name], prior)
            sigma = math.nan
            if k is not None and result.statistics is not None:
                sigma = float(result.statistics.shared_sigma[k])
            parameters[name] = {
                "value": number(value),
                "standard_deviation": number(sigma),
                "before": number(start[name]),
                "prior": number(prior),
                "found": k is not None,
                "t": number(t),
                "significant": None if math.isnan(t) else abs(t) > limit,
            }
        cameras.append({"name": camera.name, "size_px": list(camera.size_px), "parameters": parameters})
        if camera.deformation is not None:
            cameras[-1]["ebner_spacing_mm"] = camera.deformation.spacing_mm
    return cameras


def _test(result: BlockAdjustment, k: int, change: float, prior: float) -> float:
    """What the observations without the prior say of a change, over its standard deviation."""
    if result.statistics is None:
        return math.nan
    variance = float(result.statistics.cofactors.shared[k, k])
    scale = result.statistics.scale
    if not variance > 0.0:
        return math.nan
    if not math.isfinite(prior):
        return change / math.sqrt(variance) / scale
    before = prior * prior
    if variance > _PRIORS_OWN * before:
        return math.nan
    return change * prior / math.sqrt(variance * (before - variance)) / scale


def calibration_findings(records: list[dict[str, Any]], result: BlockAdjustment) -> list[str]:
    """Ebner's twelve in words: which are significant, which are not, and what is hardly told apart."""
    findings = []
    for camera in records:
        own = {n: p for n, p in camera["parameters"].items() if n in _TWELVE and p["found"]}
        if not own:
            continue
        words = {n: _micrometres(n, p) for n, p in own.items()}
        good = [words[n] for n, p in own.items() if p["significant"]]
        rest = [words[n] for n, p in own.items() if not p["significant"]]
        text = f"Ebner's parameters of {camera['name']}, µm at {camera['ebner_spacing_mm']:.1f} mm: "
        text += f"{len(good)} of {len(own)} significant" + (f" ({', '.join(good)})" if good else "")
        if rest:
            text += f"; not: {', '.join(rest)}: could be held"
        findings.append(text)
        label = f"{camera['name']}: "
        close = [
            f"{c.first.removeprefix(label)} and {c.second.removeprefix(label)} ({c.value:+.3f})"
            for c in result.correlations
            if any(side.removeprefix(label) in own for side in (c.first, c.second))
        ]
        if close:
            findings.append(
                f"overparametrised: Ebner's parameters of {camera['name']} that are hardly told apart from "
                f"others, correlations over 95 %: {', '.join(close)}; hold one of each"
            )
    return findings


def _micrometres(name: str, parameter: dict[str, Any]) -> str:
    sigma = parameter["standard_deviation"]
    accuracy = "" if sigma is None else f" ± {sigma * 1e3:.1f}"
    return f"{name.removeprefix('ebner_')} {parameter['value'] * 1e3:+.1f}{accuracy}"
