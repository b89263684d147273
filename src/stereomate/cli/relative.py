"""`stereomate relative`: orient two photographs to each other from their pixels, or from measured points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from stereomate.cli import relative_options as given
from stereomate.cli.output import plain, print_json
from stereomate.cli.relative_points import PointsInput, orient_points
from stereomate.cli.relative_print import print_counts, print_orientation

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from stereomate.camera.model import Camera
    from stereomate.relative.automatic import AutomaticOrientation, Prior
    from stereomate.relative.pair import RelativePose


@dataclass(frozen=True)
class PairInput:
    """The two photographs: files, names, cameras, and what the project knows of them."""

    files: tuple[Path, Path]
    names: tuple[str, str]
    cameras: tuple[Camera, Camera]
    prior: Prior | None = None
    given: RelativePose | None = None


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("relative")(_relative)


def _relative(
    left: given.Left = None,
    right: given.Right = None,
    camera: given.CameraFile = None,
    project: given.Project = None,
    figures: given.Figures = None,
    output: given.Output = None,
    json: given.Json = False,
    largest_side: given.LargestSide = 2200,
    seed: given.Seed = 0,
    points: given.Points = None,
    principal_distance: given.PrincipalDistance = None,
    sigma: given.Sigma = None,
    equal_weights: given.EqualWeights = False,
) -> None:
    """Relative orientation of two photographs, automatically or from measured points, with its accuracy.

    Exit code 2 and the reason where the photographs or points do not determine it.
    """
    from stereomate.errors import InputError

    if points is not None:
        if left is not None or project is not None:
            raise InputError(
                "must stand without photographs and project", field="--points", value=str(points)
            )
        table = PointsInput(points, camera, principal_distance, sigma, equal_weights, seed)
        orient_points(table, output, figures, json)
        return
    if left is None or right is None:
        raise InputError("must be two photographs, or --points", field="LEFT RIGHT", value=left)
    for option, value in (("--principal-distance", principal_distance), ("--sigma", sigma)):
        if value is not None:
            raise InputError("belongs to --points", field=option, value=value)
    if (camera is None) == (project is None):
        raise InputError("must be given, one of the two", field="--camera or --project")
    pair = _of_project(project, left, right) if project is not None else pair_of_files(camera, left, right)
    images = [grey_photograph(file) for file in pair.files]
    result = _orient(pair, images, largest_side, seed)
    if output is not None:
        _write_record(output, result, pair)
    if figures is not None and result.orientation is not None:
        _write_figures(figures, result, pair, images)
    if json:
        from stereomate.relative.summary import pair_record

        print_json(pair_record(result, pair.names, points=False))
    else:
        _print(result, pair)
    if not result.determined:
        from stereomate.errors import NotDeterminedError

        names = " and ".join(pair.names)
        raise NotDeterminedError(f"{names} are not oriented: {'; '.join(result.reasons)}")


def pair_of_files(camera: Path | None, left: str, right: str) -> PairInput:
    """Two photographs by their files, with the cameras of a file."""
    from stereomate.errors import InputError

    assert camera is not None
    files = Path(left), Path(right)
    if files[0].exists() and files[1].exists() and files[0].samefile(files[1]):
        raise InputError("must be another photograph than the left one", field="RIGHT", value=right)
    return PairInput(files, (files[0].name, files[1].name), cameras_of_pair(camera))


def cameras_of_pair(file: Path) -> tuple[Camera, Camera]:
    """Cameras of the left and right photograph: one for both, or two."""
    from stereomate.errors import InputError
    from stereomate.project.cameras import load_cameras

    cameras = load_cameras(file)
    if len(cameras) > 2:
        raise InputError("must have one camera, or two", file=file, field="camera", value=len(cameras))
    return cameras[0], cameras[-1]


def _of_project(path: Path, left: str, right: str) -> PairInput:
    import numpy as np

    from stereomate.errors import ProjectError
    from stereomate.project import load
    from stereomate.relative.automatic import Prior
    from stereomate.relative.pair import RelativePose

    loaded = load(path)
    photographs = {photo.name: (k, photo) for k, photo in enumerate(loaded.survey.photographs)}
    for photo in loaded.survey.photographs:
        # A name may be written with its suffix or as a path.
        if photo.path is not None:
            photographs.setdefault(photo.path.name, photographs[photo.name])
            photographs.setdefault(str(photo.path), photographs[photo.name])
    for name in (left, right):
        if name not in photographs:
            raise ProjectError("must be a photograph of the project", file=path, field="photo", value=name)
    (k, one), (_, other) = photographs[left], photographs[right]
    if one.name == other.name:
        raise ProjectError("must be two photographs", file=path, field="photo", value=one.name)
    if one.path is None or other.path is None:
        raise ProjectError("must have files", file=path, field="photos", value=(left, right))
    pose = RelativePose.from_exterior(
        one.orientation.centre,
        one.orientation.object_from_camera,
        other.orientation.centre,
        other.orientation.object_from_camera,
    )
    prior = None
    if loaded.ground is not None:
        base = float(np.linalg.norm(np.subtract(other.orientation.centre, one.orientation.centre)))
        above = float(loaded.ground.flying_height_m[k])
        # A tilt wrong by 3° and the relief move a point by this much.
        reach = 0.05 + 3.0 * base / above * loaded.ground.relief_m / above
        focal = one.camera.principal_distance_mm * _pixels_per_mm(one.camera)
        prior = Prior(pose, above / base, reach * focal)
    return PairInput((one.path, other.path), (one.name, other.name), (one.camera, other.camera), prior, pose)


def _pixels_per_mm(camera: Camera) -> float:
    import numpy as np

    return float(np.sqrt(abs(np.linalg.det(np.asarray(camera.pixel_from_photo)[:, :2]))))


def _orient(
    pair: PairInput, images: list[NDArray[np.uint8]], largest_side: int, seed: int
) -> AutomaticOrientation:
    from stereomate.relative.automatic import AutomaticOptions, orient_photographs
    from stereomate.relative.orientation import RelativeOptions
    from stereomate.relative.robust import RobustOptions

    options = AutomaticOptions(
        largest_side_px=largest_side, orientation=RelativeOptions(search=RobustOptions(seed=seed))
    )
    left, right = pair.cameras
    return orient_photographs(images[0], images[1], left, right, options, pair.prior)


def grey_photograph(file: Path) -> NDArray[np.uint8]:
    """A whole photograph in grey."""
    from stereomate.measurement.features import grey_image
    from stereomate.raster import open_photo

    with open_photo(file) as reader:
        return grey_image(reader.read_window(0, 0, *reader.size)[0])


def _write_figures(
    folder: Path, result: AutomaticOrientation, pair: PairInput, images: list[NDArray[np.uint8]]
) -> None:
    from stereomate.measurement.features import reduced_image
    from stereomate.report.overcorrection_style import save_figure
    from stereomate.report.relative import match_picture, parallax_picture, six_point_picture

    figure_folder(folder)
    factor = max(1, max(images[0].shape) // 1200)
    left, right = (reduced_image(image, factor) for image in images)
    save_figure(match_picture(left, right, result, pair.names, factor), folder / "matches.png")
    save_figure(parallax_picture(left, result, pair.names[0], factor), folder / "y-parallaxes.png")
    if result.determined:
        assert result.orientation is not None
        save_figure(six_point_picture(result.orientation, ", ".join(pair.names)), folder / "six-points.png")


def figure_folder(folder: Path) -> None:
    """Make the folder of figures, if it is not there."""
    from stereomate.raster.files import storing

    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)


def _write_record(path: Path, result: AutomaticOrientation, pair: PairInput) -> None:
    import json

    from stereomate.raster.files import write_whole
    from stereomate.relative.summary import pair_record

    write_whole(
        path, [json.dumps(plain(pair_record(result, pair.names)), ensure_ascii=False).encode() + b"\n"]
    )


def _print(result: AutomaticOrientation, pair: PairInput) -> None:
    print_counts(" and ".join(pair.names), result.counts, result.notes)
    if result.orientation is not None and result.determined:
        print_orientation(result.orientation, pair.given)
