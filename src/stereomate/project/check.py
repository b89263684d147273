"""Everything that can be said about a project without computing it: what `stereomate check` prints."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stereomate.coverage.footprints import Footprint
from stereomate.coverage.pairs import Pair
from stereomate.coverage.summary import Coverage, survey_coverage
from stereomate.errors import CoverageError
from stereomate.project.compare import Comparison
from stereomate.project.model import Project
from stereomate.project.orientation_sections import (
    PairGeometry,
    ProjectSectionOptions,
    sections_of_coverage,
)
from stereomate.project.run import RunOptions, plan
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.layout import MIN_OVERLAP
from stereomate.terrain.model import HeightModel

# Products much finer than the photographs only grow; the user should know.
_FINEST_SHARE_OF_GSD = 0.5
_FULLY_COVERED = 0.995


@dataclass(frozen=True)
class PhotoRow:
    """One photograph."""

    name: str
    size_px: tuple[int, int]
    bands: int
    dtype: str
    camera: str
    gsd_m: float
    height_above_ground_m: float
    tilt_deg: float
    covered: float


@dataclass(frozen=True)
class PairRow:
    """One pair of overlapping photographs.

    Attributes
    ----------
    azimuth_deg : float
        Of the base, clockwise from grid north.
    factors : (float, float) or None
        Over-correction factors of the sections nearest to both centres, ±inf on the critical circle; None
        without a height model, with too little overlap, or where no section has three usable points.
    strength : float or None
        Of the relative orientation: 1 is flat ground under a normal-angle camera, 0 the critical circle.
    geometry : str
        In one word: good, weak, near critical, no section; empty where the overlap is too little.
    """

    first: str
    second: str
    overlap: float
    base_m: float
    base_height: float
    azimuth_deg: float
    serves: bool
    factors: tuple[float, float] | None = None
    strength: float | None = None
    geometry: str = ""


@dataclass(frozen=True)
class TerrainRow:
    """The height model."""

    file: str
    crs: str
    heights: str
    size: tuple[int, int]
    resolution_m: float
    lowest: float
    highest: float
    covered: float


@dataclass(frozen=True)
class ProductRow:
    """One orthophoto with its stereomate, if it has one, and the photograph each pixel is from."""

    name: str
    files: tuple[str, ...]
    size_px: tuple[int, int]
    gsd: float
    rotation_deg: float
    bands: int
    dtype: str
    models: int
    law: str
    base_m: float | None
    w0_m: float | None
    reference_m: float | None
    megabytes: float


@dataclass(frozen=True)
class CheckReport:
    """What `check` found.

    Attributes
    ----------
    problems : tuple of str
        What is wrong: photographs left out, products that cannot be made.
    warnings : tuple of str
        What works, but perhaps not as meant.
    notes : tuple of str
        What was assumed.
    """

    project: str
    file: str
    crs: str
    heights: str
    tangent_origin: tuple[float, float, float]
    photographs: tuple[PhotoRow, ...]
    pairs: tuple[PairRow, ...]
    terrain: TerrainRow | None
    products: tuple[ProductRow, ...]
    comparison: Comparison | None
    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def is_good(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problems


def check_project(project: Project) -> CheckReport:
    """Coverage, pairs and products of a loaded project, with what is wrong or doubtful about them.

    Raises
    ------
    CoverageError, OrientationError
        If no photograph sees any ground.
    """
    problems = [str(problem.error) for problem in project.problems]
    warnings = list(project.warnings)
    heights = project.heights
    ground = heights if heights is not None else _plane(project)
    coverage = survey_coverage(project.survey, ground)
    problems += [str(problem) for problem in coverage.problems]
    jobs: list[RectifyJob] = []
    if heights is None:
        problems.append(f"{project.path}: terrain: must be given to make products")
    else:
        jobs = _jobs(project, problems)
    _doubts(project, coverage, jobs, warnings)
    if project.comparison is not None and not project.comparison.is_same:
        warnings.append(project.comparison.sentence)
    tangent = project.tangent
    strengths = _strengths(project, coverage, warnings)
    return CheckReport(
        project=project.name,
        file=str(project.path),
        crs=project.frame.name,
        heights=project.frame.heights.description,
        tangent_origin=(tangent.longitude_deg, tangent.latitude_deg, tangent.height_m),
        photographs=tuple(_photo_rows(project, coverage)),
        pairs=tuple(_pair_row(pair, project, strengths.get(pair.names)) for pair in coverage.pairs),
        terrain=None if heights is None else _terrain_row(heights, coverage),
        products=tuple(_product_row(job) for job in jobs),
        comparison=project.comparison,
        problems=tuple(problems),
        warnings=tuple(warnings),
        notes=project.notes,
    )


def _plane(project: Project) -> float:
    raise CoverageError(
        "needs a height model: without one nothing says where the ground is",
        file=project.path,
        hint="stereomate surface matches one from the oriented photographs, and run does it by itself",
    )


def _jobs(project: Project, problems: list[str]) -> list[RectifyJob]:
    """Jobs that `run` would make; an orthophoto alone where no pair serves, which is said."""
    for stereo, what in ((True, "stereomate"), (False, "orthophoto")):
        try:
            return plan(project, RunOptions(stereo=stereo))[1]
        except CoverageError as error:
            problems.append(f"no {what}: {error}")
    return []


def _doubts(project: Project, coverage: Coverage, jobs: list[RectifyJob], warnings: list[str]) -> None:
    if project.heights is not None and coverage.covered < _FULLY_COVERED:
        warnings.append(
            f"the height model covers {coverage.covered:.1%} of the photographs; the rest stays empty"
        )
    gsd = project.options.gsd
    if gsd is not None:
        ratio = gsd * project.frame.unit_m / coverage.gsd_m
        if ratio < _FINEST_SHARE_OF_GSD:
            warnings.append(f"products.gsd = {gsd:g} is {1 / ratio:.1f} times finer than the photographs")
    alone = {photo.name for photo in project.survey.photographs}
    for pair in coverage.pairs:
        alone -= set(pair.names)
    if alone and len(project.survey.photographs) > 1:
        overlap = "overlaps" if len(alone) == 1 else "overlap"
        names = ", ".join(sorted(alone)[:5])
        warnings.append(f"{_counted(len(alone), 'photograph')} {overlap} no other: {names}")


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _photo_rows(project: Project, coverage: Coverage) -> list[PhotoRow]:
    rows = []
    for photo, footprint in zip(project.survey.photographs, coverage.footprints, strict=True):
        info = project.infos[photo.name]
        rows.append(
            PhotoRow(
                name=photo.name,
                size_px=info.size,
                bands=info.bands,
                dtype=info.dtype.name,
                camera=photo.camera.name,
                gsd_m=_of(footprint, "gsd_m"),
                height_above_ground_m=_of(footprint, "height_above_ground_m"),
                tilt_deg=_of(footprint, "tilt_deg"),
                covered=0.0 if footprint is None else footprint.covered,
            )
        )
    return rows


def _of(footprint: Footprint | None, name: str) -> float:
    return math.nan if footprint is None else float(getattr(footprint, name))


def _strengths(
    project: Project, coverage: Coverage, warnings: list[str]
) -> dict[tuple[str, str], PairGeometry]:
    """Geometry of the relative orientation by pair, from the height model alone: no image is read."""
    if project.heights is None:
        return {}
    found = sections_of_coverage(project, coverage, ProjectSectionOptions(least_contrast=0.0))
    doubtful = [" - ".join(g.names) for g in found if g.verdict in ("near critical", "no section")]
    if doubtful:
        warnings.append(
            f"{_counted(len(doubtful), 'pair')} near the critical circle, "
            "or without three usable points in any section: "
            f"{', '.join(doubtful[:5])}{' ...' if len(doubtful) > 5 else ''}; "
            "see stereomate overcorrection section"
        )
    return {geometry.names: geometry for geometry in found}


def _pair_row(pair: Pair, project: Project, geometry: PairGeometry | None) -> PairRow:
    options = project.options
    serves = pair.overlap >= MIN_OVERLAP
    serves = serves and options.min_base_height <= pair.base_height <= options.max_base_height
    return PairRow(
        *pair.names,
        overlap=pair.overlap,
        base_m=pair.base_m,
        base_height=pair.base_height,
        azimuth_deg=pair.azimuth_deg,
        serves=serves,
        factors=None if geometry is None else geometry.end_factors,
        strength=geometry.sections.strength if geometry is not None and geometry.points else None,
        geometry="" if geometry is None else geometry.verdict,
    )


def _terrain_row(heights: HeightModel, coverage: Coverage) -> TerrainRow:
    rows, columns = heights.shape
    return TerrainRow(
        file=heights.name,
        crs=heights.frame.name,
        heights=heights.frame.heights.description,
        size=(columns, rows),
        resolution_m=heights.resolution_m,
        lowest=heights.min,
        highest=heights.max,
        covered=coverage.covered,
    )


def _product_row(job: RectifyJob) -> ProductRow:
    columns, rows = job.grid.size
    suffix = f"_{job.name}" if job.name else ""
    rasters = ("ortho", "mate") if job.is_stereo else ("ortho",)
    overviews = 4.0 / 3.0 if job.options.overviews else 1.0
    # The lineage has one band of two bytes for each of them.
    per_pixel = len(rasters) * (len(job.bands) * job.dtype.itemsize + 2)
    files = tuple(f"{name}{suffix}.tif" for name in (*rasters, "lineage"))
    stereo = job.is_stereo
    return ProductRow(
        name=job.name,
        files=files,
        size_px=job.grid.size,
        gsd=job.grid.gsd,
        rotation_deg=-math.degrees(job.grid.rotation) + 0.0,
        bands=len(job.bands),
        dtype=job.dtype.name,
        models=sum(model.right >= 0 for model in job.models),
        law=job.law.kind,
        base_m=job.law.base_m if stereo else None,
        w0_m=job.law.w0_m if stereo else None,
        reference_m=job.law.reference_m if stereo else None,
        megabytes=columns * rows * per_pixel * overviews / 1e6,
    )
