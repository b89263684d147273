"""Angles and lengths: the factors to radians and metres, and readers of written angles."""

from __future__ import annotations

import math
from typing import Final, Literal

AngleUnit = Literal["deg", "gon", "rad", "deg.mmss"]

DEGREE: Final = math.pi / 180.0
GON: Final = math.pi / 200.0
ARC_SECOND: Final = DEGREE / 3600.0
FOOT: Final = 0.3048
US_SURVEY_FOOT: Final = 1200.0 / 3937.0


def radians_from(value: float, unit: AngleUnit) -> float:
    """Angle in radians from a number in `unit`.

    ``deg.mmss`` is the surveyor's packed form: 12.3456 is 12° 34' 56".

    Raises
    ------
    ValueError
        If minutes or seconds of a packed angle are 60 or more, or the unit is unknown.
    """
    if unit == "rad":
        return value
    if unit == "deg":
        return value * DEGREE
    if unit == "gon":
        return value * GON
    if unit == "deg.mmss":
        return _packed_degrees(value) * DEGREE
    raise ValueError(f"unit must be one of deg, gon, rad, deg.mmss, got {unit!r}")


def from_radians(value: float, unit: AngleUnit) -> float:
    """Number in `unit` from an angle in radians: the inverse of `radians_from`."""
    if unit == "rad":
        return value
    if unit == "deg":
        return value / DEGREE
    if unit == "gon":
        return value / GON
    if unit == "deg.mmss":
        # Seconds are rounded to 1e-8 first, so that 59.999999999 does not print as 60.
        total = round(abs(value) / DEGREE * 3600.0, 8)
        degrees, rest = divmod(total, 3600.0)
        minutes, seconds = divmod(rest, 60.0)
        return math.copysign(degrees + minutes / 100.0 + seconds / 10000.0, value)
    raise ValueError(f"unit must be one of deg, gon, rad, deg.mmss, got {unit!r}")


def _packed_degrees(value: float) -> float:
    # Twelve decimals hold seconds to 1e-8; the text form avoids 12.34 -> 12° 33' 60".
    text = f"{abs(value):.12f}"
    whole, fraction = text.split(".")
    minutes, seconds = int(fraction[:2]), float(f"{fraction[2:4]}.{fraction[4:]}")
    if minutes >= 60 or seconds >= 60.0:
        raise ValueError(f"a packed angle deg.mmss has minutes and seconds below 60, got {value!r}")
    return math.copysign(int(whole) + minutes / 60.0 + seconds / 3600.0, value)
