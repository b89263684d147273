"""The project file as written: every key, its type and its rule.

The models hold what the file says, not what it means: `stereomate.project.loader` turns them into domain
values. Unknown keys are refused. ``docs/project_file.md`` documents every key.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from stereomate.forms import PROJECT
from stereomate.project.schema_camera import (
    ALL_COEFFICIENTS,
    COEFFICIENTS,
    Calibrated,
    CameraSection,
    DistortionSection,
    Finite,
    Parameter,
    Positive,
    Section,
    exactly_one,
)
from stereomate.rectify.options import (
    Compression,
    DataType,
    HeightsInterpolation,
    Hidden,
    LawKind,
    Masking,
    Resampling,
    SeamKind,
)

Three = Annotated[tuple[float, float, float], Field(strict=False)]
Four = Annotated[tuple[float, float, float, float], Field(strict=False)]
Names = Annotated[tuple[str, ...], Field(strict=False)]
Bands = Annotated[tuple[int, ...], Field(strict=False)]
Pair = Annotated[tuple[str, str], Field(strict=False)]
Pairs = Annotated[tuple[Pair, ...], Field(strict=False)]
Sigmas = Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]
Groups = dict[str, Names]

AnglesAxes = Literal["grid", "local", "tangent", "rph"]
AngleOrder = Literal["omega-phi-kappa", "phi-omega-kappa"]
AngleUnit = Literal["deg", "gon", "rad", "deg.mmss"]
AdjustedIn = Literal["grid", "space"]
Mount = Literal["y_forward", "x_forward", "gimbal"]


class ProjectSection(Section):
    """``[project]``."""

    format: int = PROJECT.version
    name: str = ""
    crs: str
    heights: str
    tangent_origin: Three | None = None


class OrientationSection(Section):
    """Where orientations come from and what their numbers mean: shared by [photos] and [photos.compare].

    `orientation` is empty where there is none yet: `stereomate orient` makes one.
    """

    orientation: str = ""
    orientation_format: Literal["auto", "table", "opensfm"] = "auto"
    columns: Names | None = None
    separator: str | None = None
    crs: str | None = None
    heights: str | None = None
    angles: AnglesAxes | None = None
    angle_order: AngleOrder = "omega-phi-kappa"
    angle_unit: AngleUnit = "deg"
    north: Literal["true", "grid"] = "true"
    mount: Mount = "y_forward"
    boresight_deg: Three | None = None
    origin: Three | None = None
    adjusted_in: AdjustedIn | None = None
    grid_reference_height: Finite | None = None
    opensfm_frame: Literal["projected", "topocentric"] | None = None

    @model_validator(mode="after")
    def _keys_that_need_each_other(self) -> OrientationSection:
        if self.angles == "tangent" and self.origin is None:
            raise ValueError('origin = [lon, lat, h] must be given with angles = "tangent"')
        if self.grid_reference_height is not None and self.adjusted_in != "grid":
            raise ValueError('grid_reference_height has a meaning only with adjusted_in = "grid"')
        if self.angles != "rph":
            for name in ("north", "mount", "boresight_deg"):
                if name in self.model_fields_set:
                    raise ValueError(f'{name} has a meaning only with angles = "rph"')
        return self


class PhotosSection(OrientationSection):
    """``[photos]``."""

    files: str | Names = ()
    exclude: Names = ()
    camera: str | None = None
    orientation_covariance: str | None = None
    compare: OrientationSection | None = None


class TerrainSection(Section):
    """``[terrain]``: a raster, or one level for flat ground."""

    file: str | None = None
    level: Finite | None = None
    # The level is a guess (of init): a surface of the oriented photographs takes its place.
    stand_in: bool = False
    crs: str | None = None
    heights: str | None = None
    unit: Literal["metre", "foot", "us-survey-foot"] | None = None
    nodata: float | None = None
    # Read by the loader: polygons where no orientation point may lie.
    water: str | None = None

    @model_validator(mode="after")
    def _file_or_level(self) -> TerrainSection:
        exactly_one(self, "file", "level")
        if self.stand_in and self.level is None:
            raise ValueError("stand_in has a meaning with level only")
        if self.level is not None:
            for name in ("crs", "heights", "unit", "nodata"):
                if name in self.model_fields_set:
                    raise ValueError(f"{name} has no meaning with level, a height of the project")
        return self


class ControlSection(Section):
    """``[control]``."""

    file: str
    crs: str | None = None
    heights: str | None = None
    columns: Names | None = None
    separator: str | None = None
    measurements: str | None = None
    check: Names = ()
    sigma_m: Sigmas | None = None
    measurement_sigma_px: Positive = 0.5


class ObservationsSection(Section):
    """``[observations]``: image observations of tie and control points."""

    files: str | Names
    points: str | None = None


class AccuracySection(Section):
    """``[accuracy]``: what is asked of the result; each is judged in the report."""

    horizontal_m: Positive | None = None
    vertical_m: Positive | None = None
    y_parallax_px: Positive | None = None


class OrientSection(Section):
    """``[orient]``: how `stereomate orient` finds the orientation of the photographs."""

    positions: Literal["auto", "exif", "none"] = "auto"
    position_sigma_m: Sigmas | None = None
    attitude_sigma_deg: Sigmas | None = None
    lever_arm_m: Three | dict[str, Three] = (0.0, 0.0, 0.0)
    lever_arm_sigma_m: Annotated[float, Field(ge=0)] = 0.0
    boresight_sigma_deg: Literal["free"] | Annotated[float, Field(ge=0)] = "free"
    mounts: Literal["camera", "one"] | Groups = "camera"
    strips: Literal["auto"] | Groups = "auto"
    strip_shift_sigma_m: Literal["free"] | Sigmas | None = None
    strip_drift_sigma_m: Literal["free"] | Sigmas | None = None
    calibrate: Literal["auto", "none"] | Calibrated = "auto"
    priors: dict[Parameter, Positive] = Field(default_factory=dict)
    tie_points: str | None = None
    features: Annotated[int, Field(ge=200, le=100_000)] = 6000
    largest_side_px: Annotated[int, Field(ge=400)] = 2200
    points_per_photo: Annotated[int, Field(ge=20)] = 400
    refine: bool = True
    pairs: Literal["auto", "all"] = "auto"
    significance: Annotated[float, Field(gt=0, lt=0.5)] = 0.001
    power: Annotated[float, Field(gt=0, lt=1)] = 0.80
    robust: Literal["snooping", "l1", "huber", "none"] = "snooping"
    variance_components: bool = False
    full_covariance: bool = False


class SurfaceSection(Section):
    """``[surface]``: the height model that is matched where the project has none."""

    use: Literal["terrain", "surface"] = "terrain"
    largest_side_px: Annotated[int, Field(ge=100)] = 2200
    pairs_per_photo: Annotated[int, Field(ge=1, le=20)] = 4
    cell: Positive | None = None
    largest_object_m: Positive = 40.0


class ProductsSection(Section):
    """``[products]``: types here, ranges in `stereomate.rectify.options.RectifyOptions`."""

    gsd: float | None = None
    law: LawKind = "logarithmic"
    base_m: float | None = None
    w0_m: float | None = None
    reference_m: float | None = None
    hidden: Hidden = "fill"
    resampling: Resampling = "cubic"
    heights_interpolation: HeightsInterpolation = "bilinear"
    rotation: Literal["auto", "north-up"] | float = "auto"
    object_height_m: float = 20.0
    bounds: Four | None = None
    min_base_height: float = 0.05
    max_base_height: float = 2.0
    compression: Compression = "zstd"
    compression_level: int | None = None
    quality: int = 90
    blocksize: int = 512
    overviews: bool = True
    masking: Masking = "auto"
    nodata: float | None = None
    dtype: DataType | None = None
    bands: Bands | None = None
    seams: SeamKind = "least-cost"
    feather_px: float = 8.0
    balance: bool = True
    strict: bool = False
    # Files that the loader reads; everything above is a field of RectifyOptions.
    law_table: str | None = None
    area: str | None = None
    sheets: str | None = None
    breaklines: str | None = None
    seam_file: str | None = None
    pairs: Pairs | None = None


class ProjectFile(Section):
    """The whole file."""

    project: ProjectSection
    camera: Annotated[tuple[CameraSection, ...], Field(strict=False)] = ()
    photos: PhotosSection
    terrain: TerrainSection | None = None
    control: ControlSection | None = None
    accuracy: AccuracySection | None = None
    observations: ObservationsSection | None = None
    orient: OrientSection = OrientSection()
    surface: SurfaceSection = SurfaceSection()
    products: ProductsSection = ProductsSection()

    @property
    def has_ground(self) -> bool:
        """Whether the ground is stated: a height model, or a level that is meant."""
        return self.terrain is not None and not self.terrain.stand_in

    @model_validator(mode="after")
    def _a_comparison_has_an_orientation(self) -> ProjectFile:
        if self.photos.compare is not None and not self.photos.compare.orientation:
            raise ValueError("photos.compare.orientation must be given")
        return self

    @model_validator(mode="after")
    def _ebner_is_of_film(self) -> ProjectFile:
        for section in self.camera:
            wanted = self.orient.calibrate if section.calibrate is None else section.calibrate
            model = None if section.distortion is None else section.distortion.model
            if model not in (None, "brown") and any(key.startswith("ebner") for key in wanted):
                raise ValueError(
                    f"calibrate: ebner goes with the brown model or none; {section.name} has {model}"
                )
        return self

    @model_validator(mode="after")
    def _undeclared_heights_are_one_system(self) -> ProjectFile:
        if self.project.heights != UNDECLARED:
            return self
        compare = self.photos.compare
        for name, section in (
            ("photos", self.photos),
            ("photos.compare", compare),
            ("terrain", self.terrain),
            ("control", self.control),
        ):
            if section is not None and section.heights not in (None, UNDECLARED):
                raise ValueError(
                    f'{name}.heights cannot declare a system when project.heights = "undeclared": '
                    "all heights are then one unknown common system"
                )
        return self


UNDECLARED: Final = "undeclared"

__all__ = [
    "ALL_COEFFICIENTS", "COEFFICIENTS", "UNDECLARED", "AccuracySection", "CameraSection", "ControlSection",
    "DistortionSection", "ObservationsSection", "OrientSection", "OrientationSection", "PhotosSection",
    "ProductsSection", "ProjectFile", "ProjectSection", "Section", "SurfaceSection", "TerrainSection",
]  # fmt: skip
