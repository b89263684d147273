"""Fiducial marks found in whole frames: drawn ones, and crops of real film painted into a frame."""

from __future__ import annotations

import functools
import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest

from stereomate.camera.fiducials import interior_orientation
from stereomate.errors import InputError, NotDeterminedError
from stereomate.measurement.fiducial_marks import (
    FiducialOptions,
    MarkTemplate,
    drawn_mark,
    find_fiducials,
)
from stereomate.measurement.mark_fit import fitted_centre

SIDE, PITCH = 2400, 0.1
CORNERS = {"1": (-106.0, -106.0), "2": (106.0, 106.0), "3": (-106.0, 106.0), "4": (106.0, -106.0)}
SIDES = {"T": (0.0, 110.0), "B": (0.0, -110.0), "L": (-110.0, 0.0), "R": (110.0, 0.0)}


@functools.cache
def empty_frame() -> np.ndarray:
    """A dark frame around a textured photograph."""
    image = np.full((SIDE, SIDE), 25.0)
    inner = cv2.GaussianBlur(np.random.default_rng(1).normal(0, 1, (SIDE, SIDE)), (0, 0), 6)
    image[120:-120, 120:-120] = 110 + 900 * inner[120:-120, 120:-120]
    return image


def painted(image: np.ndarray, picture: np.ndarray, centre: tuple[float, float], at: np.ndarray) -> None:
    """Put a picture so that its centre comes to a place to parts of a pixel."""
    rows, cols = picture.shape
    left, top = at[0] - centre[0], at[1] - centre[1]
    c0, r0 = int(np.floor(left)), int(np.floor(top))
    shift = np.array([[1, 0, left - c0], [0, 1, top - r0]])
    moved = cv2.warpAffine(
        picture.astype(np.float64),
        shift,
        (cols, rows),
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    image[r0 : r0 + rows, c0 : c0 + cols] = moved


def scanned(image: np.ndarray, rotation: int, mirrored: bool, rng: np.random.Generator) -> np.ndarray:
    """Mirrored and turned as a scan may be, with its noise."""
    picture = image[:, ::-1] if mirrored else image
    turned = np.rot90(picture, -(rotation // 90))
    return np.clip(np.rint(turned + rng.normal(0, 2.0, turned.shape)), 0, 255).astype(np.uint8)


def place(xy: tuple[float, float], offset: np.ndarray) -> np.ndarray:
    """Pixel of a mark in the upright scan."""
    return np.array([SIDE / 2 + xy[0] / PITCH, SIDE / 2 - xy[1] / PITCH]) + offset


def in_scan(pixel: np.ndarray, rotation: int, mirrored: bool) -> np.ndarray:
    """The same place in the scan as it lies."""
    col, row = pixel
    if mirrored:
        col = SIDE - col
    for _ in range(rotation // 90):
        col, row = SIDE - row, col
    return np.array([col, row])


def reader(image: np.ndarray):
    return lambda col, row, cols, rows: image[row : row + rows, col : col + cols]


@pytest.mark.parametrize("kind", ["cross", "dot", "circle"])
def test_drawn_marks_to_parts_of_a_pixel(kind) -> None:
    rng = np.random.default_rng(2)
    image = empty_frame().copy()
    mark = drawn_mark(kind, 40.0, 5.0)
    truth = {}
    for name, xy in CORNERS.items():
        truth[name] = place(xy, rng.uniform(-15, 15, 2))
        painted(image, 25.0 + 180.0 * mark.picture, mark.centre_px, truth[name])
    scan = scanned(image, 0, False, rng)
    found = find_fiducials(reader(scan), (SIDE, SIDE), CORNERS, drawn_mark(kind, 38.0, 5.5), PITCH)
    assert not found.missing
    for mark_found in found.marks:
        np.testing.assert_allclose(mark_found.pixel, truth[mark_found.name], atol=0.2)
    # Marks that look the same from all sides do not tell how the film lies, and that is said.
    assert len(found.others) == 7


@pytest.mark.parametrize("kind", ["cross", "dot", "circle", "notch"])
def test_marks_of_another_scan_turned_a_little_and_beside_other_things(kind) -> None:
    """A crop of a noisy scan found in others: a dot has no direction, and a crop more in it than the mark."""
    rng = np.random.default_rng(4)
    size, side = 20.0, 44

    def painted_scan(centre: np.ndarray, degrees: float) -> np.ndarray:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        fine = (np.arange(side * 5) + 0.5) / 5
        right, down = np.meshgrid(fine - centre[0], fine - centre[1])
        x, y = c * right + s * down, c * down - s * right
        on = {
            "cross": (np.maximum(np.abs(x), np.abs(y)) <= size / 2)
            & (np.minimum(np.abs(x), np.abs(y)) <= 2.0),
            "dot": np.hypot(x, y) <= size / 2,
            "circle": np.abs(np.hypot(x, y) - size / 2) <= 2.0,
            "notch": (x <= 0.0) & (np.abs(y) <= -x) | (x <= -size / 2),
        }[kind]
        picture = 30.0 + 170.0 * on.reshape(side, 5, side, 5).mean(axis=(1, 3))
        picture[:3] += 80.0 * rng.uniform(size=(3, 1))
        return (cv2.GaussianBlur(picture, (0, 0), 0.8) + rng.normal(0, 3, picture.shape)).astype(np.float32)

    first = np.array([22.3, 21.6])
    crop, centre = painted_scan(first, 0.0)[3:41, 3:41], (first - 3.0).tolist()
    drawn = drawn_mark(kind, 0.96 * size, 4.2)
    errors = []
    for _ in range(12):
        truth = np.array([22.0, 22.0]) + rng.uniform(-0.9, 0.9, 2)
        scan = painted_scan(truth, rng.uniform(-1.0, 1.0))
        errors.append(np.subtract(fitted_centre(crop, (centre[0], centre[1]), scan, 3.0, 3.0), truth))
        start = np.round(truth - drawn.centre_px).tolist()
        errors.append(np.subtract(fitted_centre(drawn.picture, drawn.centre_px, scan, *start), truth))
    assert np.abs(errors).max() < 0.2
    assert np.sqrt(np.mean(np.square(errors))) < 0.07


CROPS = "hipp_fiducials/examples/fiducial_proxy_detection/input_data/fiducials"
FILMS = ["nagap/curve", "nagap/block", "nagap/triangle", "nagap/arc", "nagap/notch", "ee/block", "ee/notch"]


def crops(folder: Path) -> dict[str, MarkTemplate]:
    """The four side marks of a film, reduced to at most 200 pixels."""
    result = {}
    for name in "TBLR":
        path = next(iter(sorted(folder.glob(f"{name}.*"))))
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(np.float32)
        factor = 200.0 / max(picture.shape)
        size = (round(picture.shape[1] * factor), round(picture.shape[0] * factor))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        result[name] = MarkTemplate(picture, (picture.shape[1] / 2, picture.shape[0] / 2))
    return result


@pytest.mark.real
@pytest.mark.parametrize("film", FILMS)
def test_crops_of_real_film_painted_into_whole_frames(film, data_folder: Path) -> None:
    """Found within 0.2 px, and how the film lies: turned by any quarter, mirrored or not."""
    templates = crops(data_folder / CROPS / film)
    rng = np.random.default_rng(FILMS.index(film))
    image = empty_frame().copy()
    truth = {}
    for name, xy in SIDES.items():
        pull = {"T": (0, 60), "B": (0, -60), "L": (60, 0), "R": (-60, 0)}[name]
        truth[name] = place(xy, np.array(pull) + rng.uniform(-15, 15, 2))
        painted(image, templates[name].picture, templates[name].centre_px, truth[name])
    lies = list(itertools.product((0, 90, 180, 270), (False, True)))
    rotation, mirrored = lies[(3 * FILMS.index(film) + 1) % 8]
    scan = scanned(image, rotation, mirrored, rng)
    found = find_fiducials(
        reader(scan), (SIDE, SIDE), SIDES, templates, PITCH, FiducialOptions(search_mm=10.0)
    )
    assert (found.rotation, found.mirrored) == (rotation, mirrored) or (rotation, mirrored) in found.others
    if (found.rotation, found.mirrored) != (rotation, mirrored):
        found = find_fiducials(
            reader(scan), (SIDE, SIDE), SIDES, templates, PITCH,
            FiducialOptions(search_mm=10.0, rotation=rotation, mirrored=mirrored),
        )  # fmt: skip
    assert not found.missing
    for mark in found.marks:
        np.testing.assert_allclose(mark.pixel, in_scan(truth[mark.name], rotation, mirrored), atol=0.2)
    upright = {
        n: (float((p[0] - SIDE / 2) * PITCH), float((SIDE / 2 - p[1]) * PITCH)) for n, p in truth.items()
    }
    interior = interior_orientation(upright, found.measured_px, "similarity")
    assert (interior.rotation, interior.mirrored) == (rotation, mirrored)
    assert max(interior.rms_mm) < 0.2 * PITCH


def test_what_cannot_be_found_is_said() -> None:
    rng = np.random.default_rng(0)
    image = empty_frame().copy()
    mark = drawn_mark("cross", 40.0, 5.0)
    for name in ("1", "2", "3"):
        painted(image, 25.0 + 180.0 * mark.picture, mark.centre_px, place(CORNERS[name], np.zeros(2)))
    scan = scanned(image, 0, False, rng)
    found = find_fiducials(reader(scan), (SIDE, SIDE), CORNERS, mark, PITCH)
    assert found.missing == ("4",)
    with pytest.raises(NotDeterminedError, match="only 0 of 4"):
        find_fiducials(reader(np.full_like(scan, 20)), (SIDE, SIDE), CORNERS, mark, PITCH)
    with pytest.raises(InputError, match=r"templates.*picture each.*4"):
        find_fiducials(reader(scan), (SIDE, SIDE), CORNERS, dict.fromkeys("123", mark), PITCH)
    with pytest.raises(InputError, match="must show something"):
        MarkTemplate(np.ones((20, 20), np.float32), (10.0, 10.0))
    with pytest.raises(InputError, match="cross, dot, circle or notch"):
        drawn_mark("star", 10.0)  # type: ignore[arg-type]


def test_a_notch_tells_how_the_film_lies() -> None:
    """One drawn notch points away from the middle at each side: four pictures, one way of lying."""
    rng = np.random.default_rng(4)
    right = drawn_mark("notch", 40.0)
    templates = {
        "R": right, "B": right.lying(90, False), "L": right.lying(180, False), "T": right.lying(270, False)
    }  # fmt: skip
    image = empty_frame().copy()
    for name, xy in SIDES.items():
        pull = {"T": (0, 40), "B": (0, -40), "L": (40, 0), "R": (-40, 0)}[name]
        template = templates[name]
        painted(image, 25.0 + 150.0 * template.picture, template.centre_px, place(xy, np.array(pull)))
    found = find_fiducials(reader(scanned(image, 0, False, rng)), (SIDE, SIDE), SIDES, templates, PITCH)
    assert not found.missing
    assert not found.mirrored
