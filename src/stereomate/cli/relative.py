"""`stereomate relative`: orient two photographs to each other from their pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereomate.cli.output import console, plain, print_json, table

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
    left: Annotated[str, typer.Argument(help="Left photograph: a file, or a name in the project.")],
    right: Annotated[str, typer.Argument(help="Right photograph.")],
    camera: Annotated[
        Path | None,
        typer.Option("--camera", help="TOML file with one [[camera]], or one each for left and right."),
    ] = None,
    project: Annotated[
        Path | None,
        typer.Option("--project", help="Project file: cameras, and orientation to start from and compare."),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", help="Folder for matches, y-parallaxes, six-point picture.")
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write the JSON record here.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the JSON record (without points).")] = False,
    largest_side: Annotated[
        int, typer.Option("--largest-side", help="Features are looked for in images reduced to this side.")
    ] = 2200,
    seed: Annotated[int, typer.Option("--seed", help="Of the random sampling.")] = 0,
) -> None:
    """Relative orientation of two photographs, automatically, with its accuracy.

    Exit code 2 and the reason where the photographs do not determine it.
    """
    from stereomate.errors import InputError

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
    from stereomate.project.cameras import load_cameras

    assert camera is not None
    cameras = load_cameras(camera)
    if len(cameras) > 2:
        raise InputError("must have one camera, or two", file=camera, field="camera", value=len(cameras))
    return PairInput(
        (Path(left), Path(right)), (Path(left).name, Path(right).name), (cameras[0], cameras[-1])
    )


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
    from stereomate.errors import StorageError
    from stereomate.measurement.features import reduced_image
    from stereomate.report.overcorrection_style import save_figure
    from stereomate.report.relative import match_picture, parallax_picture, six_point_picture

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{folder}: cannot make the folder ({error.strerror})") from error
    factor = max(1, max(images[0].shape) // 1200)
    left, right = (reduced_image(image, factor) for image in images)
    save_figure(match_picture(left, right, result, pair.names, factor), folder / "matches.png")
    save_figure(parallax_picture(left, result, pair.names[0], factor), folder / "y-parallaxes.png")
    if result.determined:
        save_figure(six_point_picture(result, pair.names), folder / "six-points.png")


def _write_record(path: Path, result: AutomaticOrientation, pair: PairInput) -> None:
    import json
    import os

    from stereomate.errors import StorageError
    from stereomate.relative.summary import pair_record

    text = json.dumps(plain(pair_record(result, pair.names)), ensure_ascii=False) + "\n"
    unfinished = path.with_name(f".{path.name}.part")
    try:
        unfinished.write_text(text, encoding="utf-8")
        os.replace(unfinished, path)
    except OSError as error:
        raise StorageError(f"{path}: cannot write the record ({error.strerror})") from error


def _print(result: AutomaticOrientation, pair: PairInput) -> None:
    import math

    from stereomate.relative.summary import available_elements, element_rows

    out = console()
    steps = [(name, str(count)) for name, count in result.counts.items()]
    out.print(table(" and ".join(pair.names), ("step", "number"), steps))
    for note in result.notes:
        out.print(note, highlight=False)
    orientation = result.orientation
    if orientation is None or not result.determined:
        return
    for kind, elements in available_elements(orientation).items():
        rows = [
            (*row, f"{elements.correlations[i][j]:+.2f} with {elements.names[j]}")
            for i, (row, j) in enumerate(
                zip(element_rows(elements), _most_correlated(elements.correlations), strict=True)
            )
        ]
        heads = ("element", "value", "standard deviation", "largest correlation")
        out.print(table(f"{kind} pair", heads, rows))
    out.print(
        f"Sampson distances {result.rms_px:.3f} px rms, sigma0 {orientation.sigma0:.2f}, "
        f"redundancy {orientation.adjustment.redundancy}",
        highlight=False,
    )
    diagnosis = orientation.diagnosis
    if diagnosis is not None:
        out.print(
            f"geometry: worst direction {diagnosis.largest_standard_deviation_deg:.4f}°; off the critical "
            f"cylinder by {100.0 * diagnosis.critical_cylinder.distance:.1f} % of the depth, "
            f"off a plane by {100.0 * diagnosis.flatness:.1f} %",
            highlight=False,
        )
    if pair.given is not None:
        turn, tilt = orientation.pose.angles_to(pair.given)
        out.print(
            f"against the orientation of the project: rotation {math.degrees(turn):.4f}°, "
            f"base {math.degrees(tilt):.4f}°",
            highlight=False,
        )


def _most_correlated(correlations: Any) -> list[int]:
    import numpy as np

    others = np.abs(correlations - np.diag(np.diag(correlations)))
    return [int(j) for j in np.argmax(others, axis=1)]
