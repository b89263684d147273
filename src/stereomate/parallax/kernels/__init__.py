"""Numeric kernels of the parallax laws and of the rows of a stereomate."""

from __future__ import annotations

from stereomate.parallax.kernels.law import (
    LINEAR,
    LOGARITHMIC,
    NATURAL,
    NONE,
    TABLE,
    height_of_q,
    heights_of_q,
    q_of_height,
    q_of_heights,
    slope,
    slopes,
)
from stereomate.parallax.kernels.rows import hidden_positions, highest_u, visible_pieces, winners

__all__ = [
    "LINEAR",
    "LOGARITHMIC",
    "NATURAL",
    "NONE",
    "TABLE",
    "height_of_q",
    "heights_of_q",
    "hidden_positions",
    "highest_u",
    "q_of_height",
    "q_of_heights",
    "slope",
    "slopes",
    "visible_pieces",
    "winners",
]
