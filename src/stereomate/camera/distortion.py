"""Lens distortion as values: the model, its coefficients, and what they mean.

Every model says its direction (which of the ideal and the measured point its formula is evaluated at), the
units of its coefficients and its convention (order and sign of the terms, axes). ``docs/camera.md`` has
the formulas with their sources; `stereomate.camera.packing` brings all of them to one form for the kernels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np

from stereomate.errors import InputError

Convention = Literal["opencv", "agisoft", "usgs", "australis"]
Direction = Literal["ideal_to_measured", "measured_to_ideal"]
Units = Literal["normalised", "mm"]


def _require_finite(owner: object, names: tuple[str, ...]) -> None:
    for name in names:
        value = getattr(owner, name)
        if not math.isfinite(value):
            raise InputError("must be a finite number", field=f"distortion.{name}", value=value)


def _require_choice(field: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise InputError(f"must be one of {', '.join(choices)}", field=f"distortion.{field}", value=value)


def _require_point(point: tuple[float, float] | None) -> None:
    if point is not None and not (np.shape(point) == (2,) and np.isfinite(point).all()):
        raise InputError(
            "must be two finite numbers, or None for the principal point",
            field="distortion.symmetry_mm",
            value=point,
        )


@dataclass(frozen=True)
class NoDistortion:
    """A pinhole: ideal and measured points are the same."""

    coefficient_names: ClassVar[tuple[str, ...]] = ()


@dataclass(frozen=True)
class BrownDistortion:
    """Radial and decentring distortion of Brown (1971) with affinity.

    With (x, y) the point the formula is evaluated at, reduced to the point of best symmetry,
    ``r² = x² + y²`` and ``R = k0 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸``, the other point is

    - ``opencv`` (y down): ``x' = x + x R + 2 p1 x y + p2 (r² + 2x²)``,
      ``y' = y + y R + p1 (r² + 2y²) + 2 p2 x y``, then ``x'' = x' + b1 x' + b2 y'``, ``y'' = y'``;
    - ``agisoft`` (y down): the same with p1 and p2 exchanged; b1 and b2 are Metashape's divided by its f;
    - ``usgs`` (y up, corrections are subtracted): ``x' = x - x R - p1 (r² + 2x²) - 2 p2 x y - b1 x - b2 y``,
      ``y' = y - y R - p2 (r² + 2y²) - 2 p1 x y``;
    - ``australis`` (y up, corrections are added; also PhotoModeler): ``usgs`` with plus signs.

    Parameters
    ----------
    k0, k1, k2, k3, k4 : float
        Radial coefficients. With units ``mm``, k1 is in mm⁻², k2 in mm⁻⁴ and so on; with ``normalised``
        lengths are divided by the principal distance.
    p1, p2 : float
        Decentring coefficients (mm⁻¹ or normalised).
    b1, b2 : float
        Affinity and shear of the x axis, without unit.
    convention : {"opencv", "agisoft", "usgs", "australis"}
        Order, signs and axes as above.
    direction : {"ideal_to_measured", "measured_to_ideal"}
        Which point goes into the formula. OpenCV and Agisoft distort the ideal point, film certificates
        correct the measured one (`usgs` the constructor sets that).
    units : {"normalised", "mm"}
        Unit of the coordinates in the formula.
    symmetry_mm : (float, float), optional
        Point of best symmetry in the photo system; the principal point of autocollimation if None.

    Raises
    ------
    InputError
        Naming the field that is not finite or not one of its choices.
    """

    k0: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    b1: float = 0.0
    b2: float = 0.0
    convention: Convention = "opencv"
    direction: Direction = "ideal_to_measured"
    units: Units = "normalised"
    symmetry_mm: tuple[float, float] | None = None

    coefficient_names: ClassVar[tuple[str, ...]] = ("k0", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2")

    def __post_init__(self) -> None:
        _require_finite(self, self.coefficient_names)
        _require_choice("convention", self.convention, get_args(Convention))
        _require_choice("direction", self.direction, get_args(Direction))
        _require_choice("units", self.units, get_args(Units))
        _require_point(self.symmetry_mm)

    @classmethod
    def from_certificate(
        cls,
        radial: tuple[float, ...],
        decentring: tuple[float, float] = (0.0, 0.0),
        symmetry_mm: tuple[float, float] | None = None,
    ) -> BrownDistortion:
        """Film certificate in the ``usgs`` form: measured to ideal, millimetres, corrections subtracted.

        Parameters
        ----------
        radial : up to 5 floats
            k0, k1, k2, k3, k4 of ``δr / r = k0 + k1 r² + …`` (mm).
        decentring : (float, float)
            p1, p2 (mm⁻¹).
        symmetry_mm : (float, float), optional
            Point of best symmetry in the fiducial system.
        """
        if len(radial) > 5:
            raise InputError("must be at most k0 to k4", field="distortion.radial", value=radial)
        k0, k1, k2, k3, k4 = (*radial, *(0.0,) * (5 - len(radial)))
        return cls(
            k0, k1, k2, k3, k4, decentring[0], decentring[1],
            convention="usgs", direction="measured_to_ideal", units="mm", symmetry_mm=symmetry_mm,
        )  # fmt: skip


@dataclass(frozen=True)
class OpenCVDistortion:
    """OpenCV's full model: radial (rational), decentring, thin prism and tilted sensor; ideal to measured.

    Normalised coordinates, y down, in OpenCV's order: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, taux,
    tauy (opencv, calib3d, "Camera Calibration and 3D Reconstruction").
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    taux: float = 0.0
    tauy: float = 0.0

    coefficient_names: ClassVar[tuple[str, ...]] = (
        "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "taux", "tauy",
    )  # fmt: skip

    def __post_init__(self) -> None:
        _require_finite(self, self.coefficient_names)
        for name in ("taux", "tauy"):
            if abs(getattr(self, name)) >= math.pi / 2:
                raise InputError(
                    "must be a tilt of less than a right angle in radians",
                    field=f"distortion.{name}",
                    value=getattr(self, name),
                )

    @classmethod
    def from_vector(cls, coefficients: tuple[float, ...]) -> OpenCVDistortion:
        """From OpenCV's ``distCoeffs`` of 0, 4, 5, 8, 12 or 14 terms.

        Raises
        ------
        InputError
            If the number of terms is another.
        """
        if len(coefficients) not in (0, 4, 5, 8, 12, 14):
            raise InputError(
                "must have 0, 4, 5, 8, 12 or 14 terms", field="distortion", value=len(coefficients)
            )
        return cls(*(float(value) for value in coefficients))


@dataclass(frozen=True)
class FisheyeDistortion:
    """Equidistant projection with OpenCV's polynomial: ``θd = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)``.

    θ is the angle to the optical axis; the image is at c θd from the principal point. Ideal to measured.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0

    coefficient_names: ClassVar[tuple[str, ...]] = ("k1", "k2", "k3", "k4")

    def __post_init__(self) -> None:
        _require_finite(self, self.coefficient_names)


@dataclass(frozen=True)
class EbnerDeformation:
    """Ebner's twelve additional parameters: what film does to the picture behind the lens.

    With (x, y) the photo coordinates divided by `spacing_mm`, ``X = x² - 2/3`` and ``Y = y² - 2/3``, the
    measured point is the one on the undeformed film plus, in mm,

    - ``dx = b1 x + b2 y - 2 b3 X + b4 x y + b5 Y + b7 x Y + b9 y X + b11 X Y``,
    - ``dy = -b1 y + b2 x + b3 x y - 2 b4 Y + b6 X + b8 y X + b10 x Y + b12 X Y``.

    At the nine points of a 3 x 3 grid of that spacing they are orthogonal to each other and to the six
    elements of the exterior orientation of a vertical photograph of flat ground; the eighteen are all that
    nine points can show (H. Ebner, *Self calibrating block adjustment*, Bildmessung und Luftbildwesen 44,
    1976). Ebner's coefficients belong to unscaled coordinates: they are these over the spacing to the power
    of the term.

    Parameters
    ----------
    spacing_mm : float
        Spacing of Ebner's grid, about the origin of the photo system: von Gruber's points.
    b1, ..., b12 : float
        Millimetres.

    Raises
    ------
    InputError
        Naming the field that breaks a rule.
    """

    spacing_mm: float
    b1: float = 0.0
    b2: float = 0.0
    b3: float = 0.0
    b4: float = 0.0
    b5: float = 0.0
    b6: float = 0.0
    b7: float = 0.0
    b8: float = 0.0
    b9: float = 0.0
    b10: float = 0.0
    b11: float = 0.0
    b12: float = 0.0

    coefficient_names: ClassVar[tuple[str, ...]] = tuple(f"b{i}" for i in range(1, 13))

    @classmethod
    def of_format(cls, format_mm: tuple[float, float]) -> EbnerDeformation:
        """No deformation yet, on the grid of a format: two fifths of its side, the base at 60 % overlap."""
        return cls(0.4 * math.sqrt(format_mm[0] * format_mm[1]))

    def __post_init__(self) -> None:
        for name in ("spacing_mm", *self.coefficient_names):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise InputError("must be a finite number", field=f"deformation.{name}", value=value)
        if not self.spacing_mm > 0.0:
            raise InputError(
                "must be positive millimetres", field="deformation.spacing_mm", value=self.spacing_mm
            )


Distortion = NoDistortion | BrownDistortion | OpenCVDistortion | FisheyeDistortion


def coefficients(distortion: Distortion | EbnerDeformation) -> tuple[float, ...]:
    """Values of the coefficients in the order of ``coefficient_names``."""
    return tuple(getattr(distortion, name) for name in distortion.coefficient_names)
