"""Bands of a matched surface, for whoever reads one without matching."""

from __future__ import annotations

from typing import Final

BANDS: Final = (
    "height of the surface, height system of the project",
    "height above the height model",
    "standard deviation of the height: noise of matching, and what the matching window smooths",
    "miss distance of the rays, positive where the left one passes on the side of v (north)",
    "correlation of the matched windows",
    "1 where the surface jumps beside the cell: it may show either level, and no standard deviation holds",
)
HEIGHT, ABOVE, SIGMA, MISS, CORRELATION, JUMP = range(6)
# Of which orthophoto a surface is: SHA-256.
ORTHO_TAG: Final = "STEREOMATE_ORTHO_SHA256"
