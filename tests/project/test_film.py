"""Film in a project: marks found in scans, interior orientation of each, and what orient makes of it."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
import scipy.ndimage
import tifffile
from run_survey import make, raster, write_tiny

from stereomate.camera.distortion import EbnerDeformation
from stereomate.cli import main
from stereomate.coverage.summary import survey_coverage
from stereomate.dense.epipolar import epipolar_pair
from stereomate.errors import ProjectError
from stereomate.measurement.fiducial_marks import MarkTemplate, drawn_mark
from stereomate.project import load
from stereomate.project.interior import interior_of_project
from stereomate.project.orient import orient

SIZE, MARGIN, PITCH = (320, 240), 90, 0.1
# Sides of the frame, not symmetric: as a certificate has them.
MARKS = {"R": (20.013, 0.021), "L": (-19.988, -0.013), "T": (0.008, 16.006), "B": (-0.017, -15.994)}
DRAWN = {"R": ("cross", 3.0), "L": ("dot", 2.0), "T": ("circle", 2.4), "B": ("cross", 3.0)}


def pasted(image: np.ndarray, picture: np.ndarray, centre: tuple[float, float], at: np.ndarray) -> None:
    """Put a grey picture so that its centre comes to a place to parts of a pixel."""
    rows, cols = picture.shape
    left, top = at[0] - centre[0], at[1] - centre[1]
    c0, r0 = int(np.floor(left)), int(np.floor(top))
    shift = np.array([[1, 0, left - c0], [0, 1, top - r0]])
    moved = cv2.warpAffine(picture.astype(np.float64), shift, (cols, rows), flags=cv2.INTER_CUBIC,
                           borderMode=cv2.BORDER_REPLICATE)  # fmt: skip
    image[r0 : r0 + rows, c0 : c0 + cols] = np.clip(moved, 0, 255)[..., None]


def film_frame(photo: np.ndarray, pictures: dict[str, MarkTemplate]) -> np.ndarray:
    """A rendered photograph in the dark frame of a film camera, marks at their certificate's places."""
    rows, cols = photo.shape[0] + 2 * MARGIN, photo.shape[1] + 2 * MARGIN
    image = np.full((rows, cols, 3), 25.0)
    image[MARGIN:-MARGIN, MARGIN:-MARGIN] = photo
    for name, xy in MARKS.items():
        template = pictures[name]
        pasted(image, template.picture, template.centre_px, upright_pixel(np.array(xy)))
    return image


def upright_pixel(xy_mm: np.ndarray) -> np.ndarray:
    """Pixel of the frame of photo coordinates."""
    middle = np.array([SIZE[0] / 2 + MARGIN, SIZE[1] / 2 + MARGIN])
    return middle + np.array([1.0, -1.0]) * xy_mm / PITCH


def lying(pixel: np.ndarray, rotation: int, mirrored: bool) -> np.ndarray:
    """Where pixels (..., 2) of the frame come to in a scan that is mirrored and then turned clockwise."""
    cols, rows = SIZE[0] + 2 * MARGIN, SIZE[1] + 2 * MARGIN
    col, row = pixel[..., 0], pixel[..., 1]
    if mirrored:
        col = cols - col
    for _ in range(rotation // 90):
        col, row = rows - row, col
        cols, rows = rows, cols
    return np.stack([col, row], axis=-1)


def scanned(image: np.ndarray, rotation: int, mirrored: bool, seed: int) -> np.ndarray:
    picture = image[:, ::-1] if mirrored else image
    turned = np.rot90(picture, -(rotation // 90))
    noise = np.random.default_rng(seed).normal(0, 1.0, turned.shape)
    return np.clip(np.rint(turned + noise), 0, 255).astype(np.uint8)


def write_film(folder: Path, ways: list[tuple[int, bool]], pictures: dict[str, MarkTemplate],
               section: str) -> tuple[Path, Path]:  # fmt: skip
    """Digital and film version of one synthetic strip: the two project files."""
    digital = write_tiny(folder / "digital", size_px=SIZE, flying_height_m=150.0)
    film = folder / "film"
    film.mkdir()
    for k, (path, way) in enumerate(zip(sorted(digital.parent.glob("strip*.tif")), ways, strict=True)):
        scan = scanned(film_frame(tifffile.imread(path), pictures), *way, seed=k)
        tifffile.imwrite(film / path.name, scan, photometric="rgb")
    for name in ("orientation.csv", "heights.tif"):
        shutil.copy(digital.parent / name, film / name)
    lines = digital.read_text(encoding="utf-8").splitlines()
    end = lines.index("[photos]")
    size = f"size_px = [{SIZE[0] + 2 * MARGIN}, {SIZE[1] + 2 * MARGIN}]"
    lines = [size if line.startswith("size_px") else line for line in lines]
    marks = ", ".join(f"{name} = [{x}, {y}]" for name, (x, y) in MARKS.items())
    lines[end:end] = ["[camera.fiducials]", f"marks = {{ {marks} }}", *section.splitlines(), ""]
    path = film / "project.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return digital, path


def templates_toml() -> str:
    inner = ", ".join(
        f'{name} = {{ kind = "{kind}", size_mm = {size}, line_mm = 0.4 }}'
        for name, (kind, size) in DRAWN.items()
    )
    return f"templates = {{ {inner} }}\nformat_mm = [32.0, 24.0]\nsearch_mm = 3.0\nsigma_mm = 0.01"


WAYS = [(0, False), (90, True), (180, False)]


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    pictures = {}
    for name, (kind, size) in DRAWN.items():
        drawn = drawn_mark(kind, size / PITCH, 0.4 / PITCH)
        pictures[name] = MarkTemplate(25.0 + 180.0 * drawn.picture, drawn.centre_px)
    return write_film(tmp_path_factory.mktemp("film"), WAYS, pictures, templates_toml())


@pytest.fixture(scope="module")
def found(survey: tuple[Path, Path]) -> list[dict]:
    """What `stereomate interior` finds; its table goes into the project."""
    path = survey[1]
    with pytest.raises(SystemExit) as end:
        main.run(["interior", str(path), "-q"])
    assert end.value.code in (0, None)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("search_mm", 'measured = "interior.csv"\nsearch_mm'), encoding="utf-8")
    return json.loads((path.parent / "interior.json").read_text())["scans"]


def test_unmeasured_film_is_named_with_the_command_that_helps(
    survey: tuple[Path, Path], tmp_path: Path
) -> None:
    shutil.copytree(survey[1].parent, tmp_path / "film")
    path = tmp_path / "film" / "project.toml"
    text = path.read_text().replace('measured = "interior.csv"\n', "")
    path.write_text(text)
    with pytest.raises(Exception, match=r"fiducial marks measured.*stereomate interior finds them"):
        load(path)


def test_marks_are_found_within_a_fifth_of_a_pixel_however_the_film_lies(found: list[dict]) -> None:
    assert len(found) == 3
    for scan, (rotation, mirrored) in zip(found, WAYS, strict=True):
        assert (scan["rotation"], scan["mirrored"]) == (rotation, mirrored), scan["photograph"]
        assert scan["missing"] == []
        assert max(scan["rms_mm"]) < 0.2 * PITCH
        for mark in scan["marks"]:
            truth = lying(upright_pixel(np.array(MARKS[mark["name"]])), rotation, mirrored)
            np.testing.assert_allclose([mark["col"], mark["row"]], truth, atol=0.2)


def test_every_scan_has_the_camera_of_its_own_marks(survey: tuple[Path, Path], found: list[dict]) -> None:
    """Ground points come to the pixels of the digital photograph, laid into the scan as it was scanned."""
    digital, film = load(survey[0]), load(survey[1])
    assert len(film.survey.photographs) == 3
    assert len({photo.camera.name for photo in film.survey.photographs}) == 3
    rng = np.random.default_rng(3)
    for one, other, way in zip(digital.survey.photographs, film.survey.photographs, WAYS, strict=True):
        pixels = rng.uniform((5, 5), (315, 235), (40, 2))
        rays = one.camera.rays_from_image(pixels)
        scan, inside = other.camera.image_from_camera(rays)
        assert inside.all()
        np.testing.assert_allclose(scan, lying(pixels + MARGIN, *way), atol=0.3)


def test_frame_covers_no_ground(survey: tuple[Path, Path], found: list[dict]) -> None:
    """Footprints and overlaps of scans are those of the photographs without their frames."""
    digital, film = (survey_coverage(load(path).survey, 0.0) for path in survey)
    for one, other in zip(digital.footprints, film.footprints, strict=True):
        shared = one.polygon.intersection(other.polygon).area
        assert shared > 0.99 * max(one.polygon.area, other.polygon.area)
    for one, other in zip(digital.pairs, film.pairs, strict=True):
        assert other.overlap == pytest.approx(one.overlap, abs=0.01)


def test_frame_and_marks_are_in_no_product(
    survey: tuple[Path, Path], found: list[dict], tmp_path: Path
) -> None:
    """The orthophoto of the scans ends where that of the digital photographs does, and shows the same."""
    products = []
    for name, path in zip(("digital", "film"), survey, strict=True):
        make(path, tmp_path / name, stereo=False, agreement=False)
        (ortho,) = (tmp_path / name).glob("ortho*.tif")
        products.append((ortho, *raster(ortho)))
    (one, pixels, valid), (other, scanned_pixels, scanned_valid) = products
    with rasterio.open(one) as a, rasterio.open(other) as b:
        col, row = (round(v) for v in ~a.transform @ (b.transform.c, b.transform.f))
    # The frame is 28 % of the picture's width on each side: its ground would reach that much further.
    whole = np.zeros((scanned_valid.shape[0] + 400, scanned_valid.shape[1] + 400), np.bool_)
    here = (slice(200 - row, 200 - row + valid.shape[0]), slice(200 - col, 200 - col + valid.shape[1]))
    whole[here] = valid
    around = scipy.ndimage.binary_dilation(whole, iterations=2)[200:-200, 200:-200]
    assert not (scanned_valid & ~around).any()
    both = scanned_valid & whole[200:-200, 200:-200]
    assert both.sum() > 0.9 * valid.sum()
    again = np.zeros((3, *whole.shape), pixels.dtype)
    again[:, here[0], here[1]] = pixels
    difference = again[:, 200:-200, 200:-200].astype(float) - scanned_pixels
    assert np.median(np.abs(difference[:, both])) < 6.0


@pytest.mark.slow
def test_products_of_deformed_film_are_those_of_flat_film(survey: tuple[Path, Path], tmp_path: Path) -> None:
    """Photographs put out of shape by up to five pixels; the project states how."""
    flat = survey[0]
    shutil.copytree(flat.parent, tmp_path / "bent", ignore=shutil.ignore_patterns("ortho*"))
    twelve = (0.3, -0.2, 0.1, -0.1, 0.2, 0.15, 0.1, -0.15, 0.1, 0.1, 0.1, -0.1)
    camera = load(flat).survey.photographs[0].camera
    bent = replace(camera, deformation=EbnerDeformation(10.0, *twelve))
    at = np.stack(np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5), axis=-1)
    there, _ = camera.image_from_camera(bent.rays_from_image(at))
    assert np.abs(there - at).max() > 4.0
    for path in sorted((tmp_path / "bent").glob("strip*.tif")):
        photo = tifffile.imread(path)
        moved = cv2.remap(
            photo, *(there - 0.5).astype(np.float32).transpose(2, 0, 1), cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REFLECT,
        )  # fmt: skip
        tifffile.imwrite(path, moved, photometric="rgb")
    project = tmp_path / "bent" / flat.name
    stated = ", ".join(f"b{k} = {value}" for k, value in enumerate(twelve, 1))
    text = project.read_text(encoding="utf-8").replace(
        "[photos]", f"ebner = {{ spacing_mm = 10.0, {stated} }}\n\n[photos]"
    )
    project.write_text(text, encoding="utf-8")
    products = []
    for name, path in (("flat", flat), ("bent", project)):
        make(path, tmp_path / "out" / name, stereo=False, agreement=False)
        (ortho,) = (tmp_path / "out" / name).glob("ortho*.tif")
        with rasterio.open(ortho) as file:
            products.append((file.transform, *raster(ortho)))
    (one, pixels, valid), (two, again, seen) = products
    col, row = (round(v) for v in ~one @ (two.c, two.f))
    top, left = max(row, 0), max(col, 0)
    height = min(valid.shape[0] - top, seen.shape[0] - (top - row))
    width = min(valid.shape[1] - left, seen.shape[1] - (left - col))
    mine = (slice(top, top + height), slice(left, left + width))
    other = (slice(top - row, top - row + height), slice(left - col, left - col + width))
    both = valid[mine] & seen[other]
    assert both.sum() > 0.85 * valid.sum()
    difference = pixels[0][mine].astype(float) - again[0][other]
    assert np.median(np.abs(difference[both])) < 4.0
    # Half a pixel off it would be another picture.
    shifted = pixels[0][mine][:, 1:].astype(float) - again[0][other][:, :-1]
    assert np.median(np.abs(difference[both])) < 0.5 * np.median(np.abs(shifted[both[:, 1:] & both[:, :-1]]))


def test_frame_is_not_matched(survey: tuple[Path, Path], found: list[dict]) -> None:
    """Epipolar images are valid where the scan shows the picture, up to its edge."""
    film = load(survey[1]).survey
    first, second = film.photographs[:2]
    spread = np.linspace(-40.0, 40.0, 9)
    ground = np.stack(np.meshgrid(spread, spread, [0.0]), axis=-1).reshape(-1, 3)
    middle = (np.array(first.orientation.centre) + second.orientation.centre) / 2.0
    pair = epipolar_pair(first, second, ground + middle - (0.0, 0.0, 150.0), 1)
    assert pair is not None
    for which, photo in enumerate((pair.left, pair.right)):
        way = WAYS[film.photographs.index(photo)]
        upright = np.zeros((SIZE[1] + 2 * MARGIN, SIZE[0] + 2 * MARGIN), np.uint8)
        upright[MARGIN:-MARGIN, MARGIN:-MARGIN] = 255
        image, valid = pair.image(which, scanned(upright, *way, seed=0))
        assert valid.any()
        # Half of the value on the edge itself, less for marks found to some tenths of a pixel.
        assert image[valid].min() > 50
        assert not valid.all()


@pytest.mark.slow
def test_film_is_oriented_from_its_scans(
    survey: tuple[Path, Path], found: list[dict], tmp_path: Path
) -> None:
    """The scans share one camera in the adjustment; the oriented project has them as film again."""
    path = survey[1]
    with path.open("a", encoding="utf-8") as file:
        file.write(
            "\n[orient]\nposition_sigma_m = [0.1, 0.1, 0.1]\nfeatures = 1200\npoints_per_photo = 120\n"
        )
    result = orient(path, tmp_path)
    record = result.record
    assert record["summary"]["oriented"] == 3
    assert [camera["name"] for camera in record["cameras"]] == ["synthetic"]
    assert record["summary"]["image_rms_px"]["columns"] < 0.4
    assert any("film camera synthetic" in note for note in record["notes"])
    oriented, truth = load(tmp_path / "oriented.toml"), load(survey[0])
    for one, other, stated in zip(
        oriented.survey.photographs, truth.survey.photographs, record["photographs"], strict=True
    ):
        turn = one.orientation.object_from_camera @ other.orientation.object_from_camera.T
        error = np.degrees([turn[2, 1], turn[0, 2], turn[1, 0]])
        # One strip leaves the tilt about its line to the accuracy that is stated; the others are fixed.
        assert np.abs(error[1:]).max() < 0.1
        assert abs(error[0]) < 4.0 * stated["standard_deviation_deg"][0]
        assert np.abs(np.subtract(one.orientation.centre, other.orientation.centre)).max() < 0.3


def test_distances_alone_and_marks_that_do_not_fit(survey: tuple[Path, Path], found: list[dict],
                                                   tmp_path: Path) -> None:  # fmt: skip
    shutil.copytree(survey[1].parent, tmp_path / "film")
    path = tmp_path / "film" / "project.toml"
    text = path.read_text()
    distances = [
        ("L", "R", 40.001),
        ("T", "B", 32.0),
        ("L", "T", 25.62),
        ("R", "T", 25.62),
        ("L", "B", 25.62),
    ]
    stated = "distances = [" + ", ".join(f'["{a}", "{b}", {d}]' for a, b, d in distances) + "]"
    path.write_text(text.replace("search_mm", f"{stated}\nsearch_mm"))
    scans = interior_of_project(path)
    assert all(scan.interior is not None for scan in scans)
    assert max(max(scan.interior.rms_mm) for scan in scans) < 0.05
    # A mark of another place: named, and the photograph is left out.
    table = (tmp_path / "film" / "interior.csv").read_text().splitlines()
    cells = table[1].split(",")
    table[1] = ",".join([*cells[:2], str(float(cells[2]) + 40.0), cells[3]])
    (tmp_path / "film" / "interior.csv").write_text("\n".join(table) + "\n")
    scans = interior_of_project(path)
    assert "where its certificate has them" in scans[0].problem
    project = load(path)
    assert len(project.survey.photographs) == 2
    assert any("fiducial marks" in str(problem.error) for problem in project.problems)
    path.write_text(text.replace("templates = {", 'templates = { X = { kind = "dot", size_mm = 1.0 },'))
    with pytest.raises(ProjectError, match="must be one of the marks"):
        load(path)


CROPS = "hipp_fiducials/examples/fiducial_proxy_detection/input_data/fiducials"
FILMS = ["nagap/curve", "nagap/block", "nagap/triangle", "nagap/arc", "nagap/notch", "ee/block", "ee/notch"]


@pytest.mark.real
def test_marks_of_real_films_in_rendered_film_photographs(data_folder: Path, tmp_path: Path) -> None:
    """Every crop of seven films painted into rendered photographs: found by the user's crop within 0.2 px."""
    ways = [(0, False), (90, False), (180, True), (270, True), (90, True), (270, False), (0, True)]
    frames = {}
    for film, way in zip(FILMS, ways, strict=True):
        folder = tmp_path / film.replace("/", "_")
        folder.mkdir()
        pictures, parts = {}, []
        for name in "RLTB":
            source = next(iter(sorted((data_folder / CROPS / film).glob(f"{name}.*"))))
            grey = cv2.imread(str(source), cv2.IMREAD_GRAYSCALE)
            factor = 90.0 / max(grey.shape)
            size = (round(grey.shape[1] * factor), round(grey.shape[0] * factor))
            crop = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
            tifffile.imwrite(folder / f"{name}.tif", crop, photometric="minisblack")
            pictures[name] = MarkTemplate(crop.astype(np.float32), (size[0] / 2, size[1] / 2))
            parts.append(f'{name} = {{ file = "../{name}.tif" }}')
        lie = f"rotation = {way[0]}\nmirrored = {str(way[1]).lower()}"
        section = f"templates = {{ {', '.join(parts)} }}\nsearch_mm = 2.0\nsigma_mm = 0.01"
        if not frames:
            digital, path = write_film(folder, [way] * 3, pictures, section)
            frames = {p.name: tifffile.imread(p) for p in sorted(digital.parent.glob("strip*.tif"))}
            text = path.read_text()
        else:
            path = folder / "film" / "project.toml"
            path.parent.mkdir()
            path.write_text(text)
            for k, (name, photo) in enumerate(frames.items()):
                tifffile.imwrite(path.parent / name, scanned(film_frame(photo, pictures), *way, seed=k),
                                 photometric="rgb")  # fmt: skip
        path.write_text(path.read_text().replace("[camera.fiducials]", f"{lie}\n[camera.fiducials]", 1))
        scans = interior_of_project(path)
        assert len(scans) == 3
        for scan in scans:
            assert not scan.problem, (film, scan.problem)
            assert (scan.interior.rotation, scan.interior.mirrored) == way
            for mark, (col, row, _) in scan.marks.items():
                truth = lying(upright_pixel(np.array(MARKS[mark])), *way)
                np.testing.assert_allclose([col, row], truth, atol=0.2, err_msg=f"{film} {mark}")


LAB = "houston_film/photo-lab"
HOUSTON = """
[project]
name = "houston"
crs = "EPSG:32615"
heights = "undeclared"

[[camera]]
name = "film"
size_px = [20480, 20480]
principal_distance_mm = 153.358
pixel_pitch_mm = 0.0119

[camera.fiducials]
marks = {{ {marks} }}
transform = "{kind}"
measured = "marks.csv"

[photos]

[orient]
tie_points = "ties.txt"
calibrate = "none"
"""


@pytest.mark.real
def test_photographs_known_by_measurements_alone(data_folder: Path, tmp_path: Path) -> None:
    """Marks and six points of a model, measured in a comparator: interior and relative orientation.

    Expected are the affine parameters that the laboratory printed; a projective one orients them as well.
    """

    def cells(path: str) -> list[list[str]]:
        text = (data_folder / path).read_text(encoding="utf-8")
        return [line.split() for line in text.splitlines() if line.strip()]

    marks = ", ".join(f'"{n}" = [{x}, {y}]' for n, x, y in cells(f"{LAB}1/data/dec_1_027-known.txt"))
    # Rows are counted negative downwards there.
    rows = [
        f"{n},0{p},{x},{-float(y)}"
        for p in (27, 28)
        for n, x, y in cells(f"{LAB}1/data/dec_1_0{p}-observed.txt")
    ]
    (tmp_path / "marks.csv").write_text("\n".join(["mark,photograph,col,row", *rows]), encoding="utf-8")
    rows = [
        f"{n} 0{p} {x} {-float(y)} 1.0"
        for p in (27, 28)
        for n, x, y in cells(f"{LAB}3/data/image_{p}_obs.txt")
    ]
    (tmp_path / "ties.txt").write_text("\n".join(rows), encoding="utf-8")
    path = tmp_path / "project.toml"
    path.write_text(HOUSTON.format(marks=marks, kind="affine"), encoding="utf-8")
    with pytest.raises(SystemExit) as end:
        main.run(["interior", str(path), "-o", str(tmp_path / "out"), "-q"])
    assert end.value.code in (0, None)
    (one, two) = json.loads((tmp_path / "out" / "interior.json").read_text())["scans"]
    (a, b, _), (c, d, _), _ = one["photo_from_pixel"]
    assert [f"{v:.10f}" for v in (a, -b, c, -d)] == [
        "0.0118994263", "0.0000002998", "-0.0000013405", "0.0119012647",
    ]  # fmt: skip
    assert [f"{v:.4f}" for v in (*one["rms_mm"], *two["rms_mm"])] == ["0.0062", "0.0049", "0.0049", "0.0047"]
    record = orient(path, tmp_path / "orient").record
    assert record["summary"]["oriented"] == 2
    assert record["summary"]["redundancy"] == 1
    path.write_text(HOUSTON.format(marks=marks, kind="projective"), encoding="utf-8")
    again = orient(path, tmp_path / "projective").record
    assert again["summary"]["oriented"] == 2
    # Other marks than those of the affine: the model is another by little, and it is another.
    rotations = [[p["omega_phi_kappa_deg"] for p in r["photographs"]] for r in (record, again)]
    assert 0.0 < np.abs(np.diff(rotations, axis=0)).max() < 0.05
