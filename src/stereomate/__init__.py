"""stereomate: rigorous orientation in map projections, and orthophotos to view and measure in stereo.

The public names are offered lazily: ``import stereomate`` loads neither numpy nor numba.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

# Public name -> module that defines it. A folder adds its names here.
_PUBLIC: dict[str, str] = {
    "StereoProduct": "stereomate.stereo.product",
    "grid_factors": "stereomate.frames.factors",
    "homogeneity": "stereomate.parallax.homogeneity",
    "overcorrection_factor": "stereomate.relative.overcorrection",
}

__all__ = ["__version__", *sorted(_PUBLIC)]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'stereomate' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_PUBLIC])
