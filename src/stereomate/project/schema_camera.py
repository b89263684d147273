"""Parts of the project file that describe cameras, and what all its tables have in common."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Two = Annotated[tuple[float, float], Field(strict=False)]
Size = Annotated[tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]], Field(strict=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]

Parameter = Literal[
    "principal_distance", "principal_point", "point_of_symmetry",
    "k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "b1", "b2", "s1", "s2", "s3", "s4", "taux", "tauy",
    "ebner", "ebner_b1", "ebner_b2", "ebner_b3", "ebner_b4", "ebner_b5", "ebner_b6",
    "ebner_b7", "ebner_b8", "ebner_b9", "ebner_b10", "ebner_b11", "ebner_b12",
]  # fmt: skip
Calibrated = Annotated[tuple[Parameter, ...], Field(strict=False)]


class Section(BaseModel):
    """A table of the project file: frozen, strict types, unknown keys refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class DistortionSection(Section):
    """``distortion = { ... }`` of a camera; coefficients that are not given are zero."""

    model: Literal["brown", "opencv", "fisheye"]
    convention: Literal["opencv", "agisoft", "usgs", "australis"] = "opencv"
    direction: Literal["ideal_to_measured", "measured_to_ideal"] = "ideal_to_measured"
    units: Literal["normalised", "mm"] = "normalised"
    point_of_symmetry_mm: Two | None = None
    k0: Finite = 0.0
    k1: Finite = 0.0
    k2: Finite = 0.0
    k3: Finite = 0.0
    k4: Finite = 0.0
    k5: Finite = 0.0
    k6: Finite = 0.0
    p1: Finite = 0.0
    p2: Finite = 0.0
    b1: Finite = 0.0
    b2: Finite = 0.0
    s1: Finite = 0.0
    s2: Finite = 0.0
    s3: Finite = 0.0
    s4: Finite = 0.0
    taux: Finite = 0.0
    tauy: Finite = 0.0

    @model_validator(mode="after")
    def _coefficients_belong_to_the_model(self) -> DistortionSection:
        known = COEFFICIENTS[self.model]
        if self.model != "brown":
            for name in ("convention", "direction", "units", "point_of_symmetry_mm"):
                if name in self.model_fields_set:
                    raise ValueError(f"{name} has a meaning only with the brown model")
        for name in sorted(self.model_fields_set & ALL_COEFFICIENTS):
            if name not in known:
                raise ValueError(f"{name} is no coefficient of the {self.model} model: {', '.join(known)}")
        return self


COEFFICIENTS: Final[dict[str, tuple[str, ...]]] = {
    "brown": ("k0", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2"),
    "opencv": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "taux", "tauy"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
ALL_COEFFICIENTS: Final = frozenset(name for names in COEFFICIENTS.values() for name in names)


class EbnerSection(Section):
    """``ebner = { ... }`` of a camera: deformation of the film, millimetres; what is not given is zero."""

    spacing_mm: Positive
    b1: Finite = 0.0
    b2: Finite = 0.0
    b3: Finite = 0.0
    b4: Finite = 0.0
    b5: Finite = 0.0
    b6: Finite = 0.0
    b7: Finite = 0.0
    b8: Finite = 0.0
    b9: Finite = 0.0
    b10: Finite = 0.0
    b11: Finite = 0.0
    b12: Finite = 0.0


class MarkSection(Section):
    """A mark's picture: drawn, or a crop of the user's own."""

    kind: Literal["cross", "dot", "circle", "notch"] | None = None
    size_mm: Positive | None = None
    line_mm: Positive | None = None
    bright: bool = True
    turned: Literal[0, 90, 180, 270] = 0
    file: str | None = None
    centre_px: Two | None = None

    @model_validator(mode="after")
    def _drawn_or_a_file(self) -> MarkSection:
        exactly_one(self, "kind", "file")
        if self.kind is not None and self.size_mm is None:
            raise ValueError("size_mm must be given with kind")
        if self.file is not None:
            for name in ("size_mm", "line_mm", "bright"):
                if name in self.model_fields_set:
                    raise ValueError(f"{name} has a meaning only with kind")
        return self


Distance = Annotated[tuple[str, str, Positive], Field(strict=False)]


class FiducialsSection(Section):
    """``[camera.fiducials]``: film. The certificate's marks, and how they are found in the scans."""

    marks: dict[str, Two] = Field(min_length=2)
    distances: Annotated[tuple[Distance, ...], Field(strict=False)] | None = None
    format_mm: Two | None = None
    transform: Literal["similarity", "affine", "projective"] = "affine"
    sigma_mm: Positive = 0.005
    measured: str | None = None
    template: MarkSection | None = None
    templates: dict[str, MarkSection] = {}
    search_mm: Positive = 8.0
    least_correlation: Annotated[float, Field(gt=0, lt=1)] = 0.6

    @model_validator(mode="after")
    def _pictures_are_of_marks(self) -> FiducialsSection:
        for name in self.templates:
            if name not in self.marks:
                raise ValueError(f"templates.{name} must be one of the marks: {', '.join(self.marks)}")
        return self


class CameraSection(Section):
    """``[[camera]]``."""

    name: str = Field(min_length=1)
    size_px: Size
    principal_distance_mm: Positive | None = None
    principal_distance_px: Positive | None = None
    sensor_mm: Two | None = None
    pixel_pitch_mm: Positive | Two | None = None
    principal_point_mm: Two | None = None
    principal_point_px: Two | None = None
    rotation: Literal[0, 90, 180, 270] = 0
    mirrored: bool = False
    distortion: DistortionSection | None = None
    ebner: EbnerSection | None = None
    fiducials: FiducialsSection | None = None
    calibrate: Literal["auto", "none"] | Calibrated | None = None
    priors: dict[Parameter, Positive] = {}

    @model_validator(mode="after")
    def _film_is_in_millimetres(self) -> CameraSection:
        if self.fiducials is not None and (
            self.principal_distance_mm is None or self.principal_point_px is not None
        ):
            raise ValueError("principal distance and point of film must be given in mm, as certificates do")
        return self

    @model_validator(mode="after")
    def _film_is_behind_a_lens_of_browns(self) -> CameraSection:
        if self.distortion is None or self.distortion.model == "brown":
            return self
        rule = f"goes with the brown model or none, not with {self.distortion.model}"
        if self.ebner is not None:
            raise ValueError(f"ebner {rule}")
        if self.fiducials is not None and self.fiducials.transform == "projective":
            raise ValueError(f"a projective transform of fiducials {rule}")
        return self

    @model_validator(mode="after")
    def _one_of_each(self) -> CameraSection:
        exactly_one(self, "principal_distance_mm", "principal_distance_px")
        at_most_one(self, "sensor_mm", "pixel_pitch_mm")
        at_most_one(self, "principal_point_mm", "principal_point_px")
        if self.principal_distance_mm is not None and self.sensor_mm is None and self.pixel_pitch_mm is None:
            raise ValueError("sensor_mm or pixel_pitch_mm must be given with principal_distance_mm")
        for name in ("sensor_mm", "pixel_pitch_mm"):
            value = getattr(self, name)
            if isinstance(value, tuple) and min(value) <= 0:
                raise ValueError(f"{name} must be positive")
        return self


def exactly_one(section: Section, *names: str) -> None:
    at_most_one(section, *names)
    if all(getattr(section, name) is None for name in names):
        raise ValueError(f"{' or '.join(names)} must be given")


def at_most_one(section: Section, *names: str) -> None:
    given = [name for name in names if getattr(section, name) is not None]
    if len(given) > 1:
        raise ValueError(f"only one of {' and '.join(given)} may be given")
