"""Orthophoto of one 99 Mpix photograph: whole commands, stereomate against orthority 0.7, in the same run.

One 11000 x 9000 RGB uint8 photograph of 0.1 m GSD over a 5 m fractal height model with 30 % relief, heading
12 degrees. Pixels are compared around the nadir, where a program that takes the grid as Cartesian has the
same positions (3 mm at 75 m).
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray

from benchmarks.processes import Usage, in_turn, median, median_ratio, peer_command, timed, timed_in_memory

SIZE = (11000, 9000)
CELL = 5.0
GSD = 0.1
FLYING_HEIGHT = 1500.0
RELIEF = 450.0
HEADING_DEG = 12.0
CRS = "+proj=tmerc +lat_0=0 +lon_0=25 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"
COMPARED_PX = 1500
RUNS = int(os.environ.get("STEREOMATE_BENCH_RUNS", "3"))
FOLDER = Path(os.environ.get("STEREOMATE_BENCH_FOLDER", "bench-results/orthophoto"))
# The large output takes minutes and 8 GB of disk: once, and only on request.
LARGE = os.environ.get("STEREOMATE_BENCH_LARGE", "") not in ("", "0")
STEREOMATE = str(Path(sys.executable).with_name("stereomate"))


def fractal(shape: tuple[int, int], seed: int, roughness: float = 0.5) -> NDArray[np.float32]:
    """Fractal noise in [0, 1]."""
    rng = np.random.default_rng(seed)
    total = np.zeros(shape, np.float32)
    amplitude, cells = 1.0, 3
    while cells < max(shape):
        coarse = rng.random((cells + 3, cells + 3), dtype=np.float32)
        total += amplitude * cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
        amplitude, cells = amplitude * roughness, cells * 2
    return (total - total.min()) / (total.max() - total.min())


def make_scene(folder: Path, copies: int = 1) -> None:
    """Photograph(s), height model, orthority's and stereomate's files."""
    if (folder / "done").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    cols, rows = SIZE
    pixels = np.empty((rows, cols, 3), np.uint8)
    for band in range(3):
        pixels[..., band] = 20 + 215 * fractal((rows, cols), band, 0.75)
    for k in range(copies):
        with rasterio.open(
            folder / f"photo{k}.tif", "w", driver="GTiff", width=cols, height=rows, count=3, dtype="uint8",
            tiled=True, blockxsize=512, blockysize=512, photometric="RGB",
        ) as file:  # fmt: skip
            file.write(np.moveaxis(pixels, -1, 0))
    edge = 480
    first = -0.5 * edge * CELL
    heights = (fractal((edge, edge), 9) - 0.5) * RELIEF
    with rasterio.open(
        folder / "dem.tif", "w", driver="GTiff", width=edge, height=edge, count=1, dtype="float32", crs=CRS,
        transform=rasterio.Affine(CELL, 0, first, 0, -CELL, -first), tiled=True, blockxsize=256,
        blockysize=256,
    ) as file:  # fmt: skip
        file.write(heights.astype(np.float32), 1)
    _write_parameters(folder, copies)
    (folder / "done").touch()


def _write_parameters(folder: Path, copies: int) -> None:
    cols, rows = SIZE
    pitch = 0.004
    c = FLYING_HEIGHT * pitch / GSD
    sensor = (cols * pitch, rows * pitch)
    names = [f"photo{k}" for k in range(copies)]
    table = "filename,x,y,z,omega,phi,kappa\n"
    for k, name in enumerate(names):
        table += f"{name},{300.0 * k},0,{FLYING_HEIGHT},0.8,-0.6,{HEADING_DEG}\n"
    (folder / "eo.csv").write_text(table)
    (folder / "int.yaml").write_text(
        f"cam:\n    type: pinhole\n    im_size: [{cols}, {rows}]\n    focal_len: {c}\n"
        f"    sensor_size: [{sensor[0]}, {sensor[1]}]\n    cx: 0.0\n    cy: 0.0\n"
    )
    for interpolation in ("bilinear", "cubic"):
        for codec in ("zstd", "deflate", "jpeg"):
            (folder / f"{interpolation}_{codec}.toml").write_text(
                _project(interpolation, codec, "photo0.tif" if copies == 1 else "photo*.tif", c, sensor)
            )


def write_pair(folder: Path) -> None:
    """The same photograph twice, 440 m apart; projects over ground that both show, of both and of one."""
    pair = folder / "pair"
    pair.mkdir(exist_ok=True)
    for k in range(2):
        link = pair / f"photo{k}.tif"
        if not link.exists():
            link.symlink_to((folder / "photo0.tif").resolve())
    if not (pair / "dem.tif").exists():
        (pair / "dem.tif").symlink_to((folder / "dem.tif").resolve())
    rows = [f"photo{k},{440.0 * k},0,{FLYING_HEIGHT},0.8,-0.6,{HEADING_DEG}" for k in range(2)]
    (pair / "eo.csv").write_text("\n".join(["filename,x,y,z,omega,phi,kappa", *rows]) + "\n")
    pitch = 0.004
    c = FLYING_HEIGHT * pitch / GSD
    # Alone means from one photograph: an orthophoto of two would look for seams, which the pair has none of.
    for name, photos in (("both.toml", "photo*.tif"), ("alone.toml", "photo0.tif")):
        text = _project("bilinear", "zstd", photos, c, (SIZE[0] * pitch, SIZE[1] * pitch))
        (pair / name).write_text(text + "bounds = [0.0, -300.0, 440.0, 300.0]\n")


def _project(interpolation: str, codec: str, photos: str, c: float, sensor: tuple[float, float]) -> str:
    return f"""
[project]
crs = "{CRS}"
heights = "undeclared"
[[camera]]
name = "cam"
principal_distance_mm = {c}
size_px = [{SIZE[0]}, {SIZE[1]}]
sensor_mm = [{sensor[0]}, {sensor[1]}]
[photos]
files = "{photos}"
orientation = "eo.csv"
angles = "grid"
adjusted_in = "space"
[terrain]
file = "dem.tif"
[products]
gsd = {GSD}
hidden = "keep"
heights_interpolation = "{interpolation}"
compression = "{codec}"
"""


def ours(folder: Path, project: str, *extra: str) -> Usage:
    """One fresh run of the whole command."""
    return timed(
        [STEREOMATE, "-q", "run", str(folder / project), "-o", str(folder / "ours"), "--fresh", *extra]
    )


def theirs(command: str, folder: Path, *extra: str) -> Usage:
    """One run of orthority's whole command."""
    out = folder / "theirs"
    out.mkdir(exist_ok=True)
    files = [
        "--dem",
        str(folder / "dem.tif"),
        "--int-param",
        str(folder / "int.yaml"),
        "--ext-param",
        str(folder / "eo.csv"),
    ]
    place = ["--crs", CRS, "--res", str(GSD), "--out-dir", str(out), "--overwrite"]
    return timed([command, "frame", *files, *place, *extra, str(folder / "photo0.tif")])


def compared(folder: Path) -> str:
    """Largest and usual difference of the two orthophotos where both are valid, whole pixels apart or not."""
    with (
        rasterio.open(folder / "ours" / "ortho.tif") as a,
        rasterio.open(next((folder / "theirs").glob("*.tif"))) as b,
    ):
        col, row = ~a.transform @ (b.transform.c, b.transform.f)
        shift = (round(col), round(row))
        if abs(col - shift[0]) > 1e-3 or abs(row - shift[1]) > 1e-3:
            return f"grids differ by a part of a pixel ({col:.3f}, {row:.3f}): not compared"
        first = [round(v) - COMPARED_PX // 2 for v in ~b.transform @ (0.0, 0.0)]
        window = rasterio.windows.Window(*first, COMPARED_PX, COMPARED_PX)
        other = rasterio.windows.Window(first[0] + shift[0], first[1] + shift[1], COMPARED_PX, COMPARED_PX)
        one, two = b.read(window=window).astype(int), a.read(window=other).astype(int)
        both = (b.dataset_mask(window=window) != 0) & (a.dataset_mask(window=other) != 0)
        difference = np.abs(one - two)[:, both]
    return f"difference: {np.mean(difference <= 1):.4%} within 1 DN, largest {difference.max()}"


def run() -> list[dict[str, Any]]:
    """Rows of the benchmark."""
    command = peer_command("oty", "orthority==0.7.0")
    if command is None:
        return [{"name": "orthophoto, 99 Mpix", "note": "orthority cannot be installed here"}]
    folder = FOLDER
    make_scene(folder)
    cubic = ("--dem-interp", "cubic", "--compress", "deflate", "--no-build-ovw", "--no-write-mask")
    bilinear = ("--dem-interp", "bilinear", *cubic[2:])
    aligned = ("--aligned-pixels",)
    rows = []
    for name, project, theirs_extra in (
        (
            "defaults of ours (zstd-1 COG, overviews, mask) against deflate, no overviews, no mask",
            "bilinear_zstd.toml",
            cubic,
        ),
        ("bilinear heights in both; ours zstd-1 COG", "bilinear_zstd.toml", (*bilinear, *aligned)),
        ("deflate in both", "bilinear_deflate.toml", bilinear),
        ("true defaults of both (theirs JPEG, mask, overviews)", "bilinear_zstd.toml", ()),
    ):
        a, b = in_turn(
            [
                lambda p=project: ours(folder, p, "--ortho-only"),
                lambda e=theirs_extra: theirs(command, folder, *e),
            ],
            RUNS,
        )
        for figure, unit in (("wall", "s"), ("cpu", "CPU s"), ("peak_mb", "MB")):
            rows.append(
                {
                    "name": f"{name}: {figure}",
                    "ours": median(a, figure),
                    "peer": median(b, figure),
                    "ratio": median_ratio(a, b, figure),
                    "unit": unit,
                    "note": compared(folder) if aligned[0] in theirs_extra and figure == "wall" else "",
                }
            )
    return rows + stereo_rows(folder) + (large_rows(folder) if LARGE else [])


def large_rows(folder: Path) -> list[dict[str, Any]]:
    """The same photograph at a third of its GSD: an output ten times larger, ours alone."""
    text = (folder / "bilinear_zstd.toml").read_text()
    (folder / "large.toml").write_text(text.replace(f"gsd = {GSD}", f"gsd = {GSD / 10**0.5:.6f}"))
    found = []
    for project in ("bilinear_zstd.toml", "large.toml"):
        command = [STEREOMATE, "-q", "run", str(folder / project), "-o", str(folder / "large")]
        usage = timed_in_memory([*command, "--ortho-only", "--fresh"])
        with rasterio.open(folder / "large" / "ortho.tif") as file:
            found.append((usage, file.width * file.height / 1e6))
    shutil.rmtree(folder / "large")
    (small, small_mpix), (large, large_mpix) = found
    name = f"output of {large_mpix:.0f} Mpix against {small_mpix:.0f} Mpix, both ours"
    note = "once; goal under 500 MB"
    per_mpix = (1e3 * large.cpu / large_mpix, 1e3 * small.cpu / small_mpix)
    return [
        _row(f"{name}: peak_mb", large.peak_mb, small.peak_mb, "MB", note),
        _row(f"{name}: CPU per Mpix", *per_mpix, "CPU ms", "once"),
        _row(f"{name}: wall", large.wall, small.wall, "s", "once"),
    ]


def _row(name: str, ours: float, peer: float, unit: str, note: str) -> dict[str, Any]:
    return {"name": name, "ours": ours, "peer": peer, "ratio": ours / peer, "unit": unit, "note": note}


def stereo_rows(folder: Path) -> list[dict[str, Any]]:
    """Orthophoto and stereomate together against the orthophoto alone, 26 Mpix of ground that both show."""
    write_pair(folder)
    pair = folder / "pair"
    both, alone = in_turn(
        [
            lambda: ours(pair, "both.toml", "--no-agreement"),
            lambda: ours(pair, "alone.toml", "--ortho-only"),
        ],
        RUNS,
    )
    return [
        {
            "name": f"orthophoto and stereomate (ours) against the orthophoto alone (peer): {figure}",
            "ours": median(both, figure),
            "peer": median(alone, figure),
            "ratio": median_ratio(both, alone, figure),
            "unit": unit,
            "note": "goal 2.2",
        }
        for figure, unit in (("wall", "s"), ("cpu", "CPU s"))
    ]
