"""A synthetic survey as files: photographs, height model, orientation table, project file and the truth."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray

from stereomate.camera.distortion import BrownDistortion, NoDistortion
from stereomate.errors import InputError
from stereomate.raster.cog.georeference import Georeference, template_tags
from stereomate.raster.cog.profile import CogProfile
from stereomate.raster.files import storing, write_whole
from stereomate.synthetic.survey import GroundPoint, SyntheticSurvey
from stereomate.tiles.executor import Executor

PhotoFormat = Literal["tif", "jpg"]
Surface = Literal["terrain", "surface"]

_TILE: Final = 256
_NODATA: Final = -9999.0
_JPEG_QUALITY: Final = 95


@dataclass(frozen=True)
class WrittenSurvey:
    """Where the files of a survey are."""

    folder: Path
    project: Path
    photographs: tuple[Path, ...]
    heights: Path
    orientation: Path
    truth: Path


def write_survey(
    survey: SyntheticSurvey,
    folder: Path,
    *,
    photos: PhotoFormat = "tif",
    surface: Surface = "terrain",
    executor: Executor | None = None,
    progress: Callable[[str], None] | None = None,
) -> WrittenSurvey:
    """Render all photographs and write everything that a project needs, with its truth beside it.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    photos : {"tif", "jpg"}
        Tiled GeoTIFF-style TIFF, lossless, or JPEG of quality 95.
    surface : {"terrain", "surface"}
        Height model of the bare ground (exactly the terrain of the world), or with roofs and crowns.
    executor : Executor, optional
        Where the photographs are rendered; one thread without.
    progress : callable, optional
        Called with the name of each file before it is made.

    Raises
    ------
    StorageError
        If the folder cannot be written.
    InputError
        If the project file has no words for the distortion.
    """
    folder = Path(folder)
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    tell = progress or (lambda name: None)
    text = project_text(survey, photos)
    images = []
    for number, photograph in enumerate(survey.survey.photographs):
        images.append(folder / f"{photograph.name}.{photos}")
        tell(images[-1].name)
        _write_photo(images[-1], survey.render(number, executor))
    written = WrittenSurvey(
        folder, folder / "project.toml", tuple(images), folder / "heights.tif", folder / "orientation.csv",
        folder / "truth.json",
    )  # fmt: skip
    tell(written.heights.name)
    world = survey.world
    write_heights(written.heights, survey, world.heights if surface == "terrain" else world.surface_model())
    write_whole(written.orientation, [orientation_table(survey, photos).encode()])
    points = [*survey.control_points, *survey.check_points]
    write_whole(folder / "points.csv", [_points_table(points).encode()])
    write_whole(written.truth, [json.dumps(truth(survey), indent=1).encode()])
    write_whole(written.project, [text.encode()])
    return written


def _write_photo(path: Path, image: NDArray[np.uint8]) -> None:
    if path.suffix == ".jpg":
        write_whole(path, [imagecodecs.jpeg8_encode(image, level=_JPEG_QUALITY, subsampling="444")])
        return
    write_whole(path, [_tiff(image, photometric="rgb", predictor=2)])


def _tiff(image: NDArray[Any], **options: Any) -> bytes:
    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer,
        image,
        tile=(_TILE, _TILE),
        compression="zstd",
        compressionargs={"level": 1},
        metadata=None,
        software=False,
        **options,
    )
    return buffer.getvalue()


def write_heights(path: Path, survey: SyntheticSurvey, heights: NDArray[np.float64]) -> None:
    """Write a height model on the survey's terrain grid: the true one, or one with errors planted in it.

    Parameters
    ----------
    heights : ndarray (rows, cols)
        Ellipsoidal heights at the nodes; NaN for voids.
    """
    world = survey.world
    if heights.shape != world.heights.shape:
        raise InputError("must have the shape of the terrain grid", field="heights", value=heights.shape)
    heights = np.where(np.isfinite(heights), heights, _NODATA)
    tags = template_tags(
        CogProfile("float32", 1, nodata=_NODATA), Georeference(world.options.crs, world.affine), ()
    )
    skipped = (262, 338)  # photometric interpretation and extra samples: tifffile writes them itself
    extra = [(t.code, t.dtype, t.count, t.data, True) for t in tags.values() if t.code not in skipped]
    data = _tiff(heights.astype(np.float32), photometric="minisblack", predictor=3, extratags=extra)
    write_whole(path, [data])


def orientation_table(survey: SyntheticSurvey, photos: PhotoFormat = "tif") -> str:
    """The true orientations as text: map position, ellipsoidal height, degrees about the grid axes."""
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["filename", "x", "y", "z", "omega", "phi", "kappa"])
    for photograph, centre, angles in zip(
        survey.survey.photographs, survey.centres, survey.angles_deg, strict=True
    ):
        # 1e-6 m and 1e-10 degrees: nothing is lost at 0.001 px
        numbers = [*(f"{v:.6f}" for v in centre), *(f"{v:.10f}" for v in angles)]
        writer.writerow([f"{photograph.name}.{photos}", *numbers])
    return table.getvalue()


def _points_table(points: Sequence[GroundPoint]) -> str:
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["name", "x", "y", "z", "type"])
    for point in points:
        kind = "control" if point.name.startswith("C") else "check"
        writer.writerow([point.name, *(f"{v:.4f}" for v in point.position), kind])
    return table.getvalue()


def project_text(survey: SyntheticSurvey, photos: PhotoFormat = "tif") -> str:
    """The project file.

    Raises
    ------
    InputError
        If the distortion is none of those it has words for.
    """
    options = survey.options
    return f"""\
# A synthetic survey with known truth (truth.json), made by stereomate.
[project]
format = 1
name = "synthetic"
crs = "{options.crs}"
heights = "ellipsoidal"

[[camera]]
name = "{survey.survey.photographs[0].camera.name}"
principal_distance_mm = {options.principal_distance_mm!r}
size_px = [{options.size_px[0]}, {options.size_px[1]}]
pixel_pitch_mm = {options.pixel_pitch_mm!r}
principal_point_mm = [{options.principal_point_mm[0]!r}, {options.principal_point_mm[1]!r}]
{_distortion_line(survey)}
[photos]
files = "strip*.{photos}"
orientation = "orientation.csv"          # filename, x, y, z, omega, phi, kappa in degrees
angles = "grid"                          # about the grid axes at each centre
adjusted_in = "space"                    # true positions

[terrain]
file = "heights.tif"                     # the bare ground, without houses and trees

[products]
gsd = {options.gsd_m!r}
law = "logarithmic"
"""


def _distortion_line(survey: SyntheticSurvey) -> str:
    distortion = survey.options.distortion
    if isinstance(distortion, NoDistortion):
        return ""
    known = ("k1", "k2", "k3", "p1", "p2", "b1", "b2")
    plain = isinstance(distortion, BrownDistortion) and distortion == BrownDistortion(
        **{name: getattr(distortion, name) for name in known}
    )
    if not plain:
        raise InputError(
            "must be none, or Brown's with k1-k3, p1, p2, b1, b2 in the default convention",
            field="distortion",
            value=distortion,
        )
    values = ", ".join(f"{name} = {getattr(distortion, name)!r}" for name in known)
    return f'distortion = {{ model = "brown", {values} }}\n'


def truth(survey: SyntheticSurvey) -> dict[str, Any]:
    """What is true about the survey, as plain values; positions are map coordinates and ellipsoidal."""
    world = survey.world
    options = asdict(survey.options)
    options["distortion"] = {"type": type(survey.options.distortion).__name__, **options["distortion"]}
    signalised = [*survey.control_points, *survey.check_points]
    return {
        "format": 1,
        "options": options,
        "terrain": {
            "rule": "bilinear surface between the pixel centres of heights.tif",
            "map_polynomial_error_m": world.polynomial.error_m,
        },
        "photographs": [
            {
                "name": photograph.name,
                "strip": int(strip),
                "centre": centre.tolist(),
                "omega_phi_kappa_grid_deg": angles.tolist(),
            }
            for photograph, strip, centre, angles in zip(
                survey.survey.photographs, survey.strips, survey.centres, survey.angles_deg, strict=True
            )
        ],
        "buildings": [
            {"roof_corners": house.corners().tolist(), "eaves": house.eaves, "ridge": house.ridge}
            for house in world.buildings
        ],
        "tree_tops": survey.tree_tops().tolist(),
        "signalised_points": [
            {"name": point.name, "position": list(point.position), "image": _images_of(survey, point)}
            for point in signalised
        ],
    }


def _images_of(survey: SyntheticSurvey, point: GroundPoint) -> dict[str, list[float]]:
    """Pixel positions in every photograph that sees the point."""
    found = {}
    for number, photograph in enumerate(survey.survey.photographs):
        pixels, _ = survey.project(number, point.position)
        if bool(survey.visible(number, point.position)):
            found[photograph.name] = [float(v) for v in pixels]
    return found
