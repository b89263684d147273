"""Everything a page asks for, as named files: the server makes them when asked, `publish` writes them all."""

from __future__ import annotations

import hashlib
import json
import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from stereomate import __version__
from stereomate.errors import FormatError, InputError
from stereomate.forms import PAGE
from stereomate.raster.pyramid import PyramidReader, open_pyramid
from stereomate.stereo.product import StereoProduct
from stereomate.viewer import binary, layers
from stereomate.viewer.imagery import TILE, Stretch, TileFormat, TileReader, encode_image, stretch_of
from stereomate.viewer.kept import Kept
from stereomate.viewer.lattice import MeasuringLattice, measuring_lattice
from stereomate.viewer.objects import object_heights, surface_of
from stereomate.viewer.page_files import page_names, read_page
from stereomate.viewer.points import read_points
from stereomate.viewer.record import (
    HEIGHT_TILE,
    HeightWindow,
    height_window,
    measuring_record,
    product_key,
    viewer_record,
)

_EYE: Final = re.compile(r"(ortho|mate)/(\d{1,2})/(\d{1,6})_(\d{1,6})\.(?:jpg|png)")
_PAIR: Final = re.compile(r"(lineage|heights)/(\d{1,6})_(\d{1,6})\.bin")
# Of a surface, to tell it from others.
_HEAD_BYTES: Final = 1 << 20
_HOMOGENEITY: Final = re.compile(r"homogeneity_(\d+)\.bin")


@dataclass(frozen=True)
class SiteOptions:
    """How the pictures of a site are written.

    Attributes
    ----------
    format : {"jpg", "png"}
        PNG is without loss, and three to five times larger.
    quality : int
        Of JPEG, 1 to 100.
    object_heights_m : tuple of float
        Heights of objects for which homogeneity is predicted.
    title, credits : str
        Shown on the page and on prints.
    points : Path, optional
        A table of control and check points to show: name, x, y, z and perhaps type.
    surface : Path, optional
        Heights of objects, as `stereomate heights` writes them; else those beside the product.
    centre_sigma_m, angle_sigma_deg : float
        Standard deviations of the orientation with which the page begins, as `MeasureOptions` has them.
    """

    format: TileFormat = "jpg"
    quality: int = 90
    object_heights_m: tuple[float, ...] = (10.0,)
    title: str = ""
    credits: str = ""
    points: Path | None = None
    surface: Path | None = None
    centre_sigma_m: float = 0.0
    angle_sigma_deg: float = 0.0

    def __post_init__(self) -> None:
        if self.format not in ("jpg", "png"):
            raise InputError("must be jpg or png", field="format", value=self.format)
        if not 1 <= self.quality <= 100:
            raise InputError("must be 1 to 100", field="quality", value=self.quality)
        for name in ("centre_sigma_m", "angle_sigma_deg"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError("must be 0 or more", field=name, value=value)
        for height in self.object_heights_m:
            if not (np.isfinite(height) and height > 0.0):
                raise InputError("must be positive", field="object_heights", value=height)


class ProductSource:
    """One product as files of a page. Safe to use from any number of threads.

    Raises
    ------
    FormatError
        If a raster of the product is missing, or does not lie in its folder.
    """

    def __init__(self, product: StereoProduct, options: SiteOptions) -> None:
        self.product, self.options = product, options
        files = product.files
        names = {"ortho": files.ortho, "mate": files.mate, "lineage": files.lineage}
        self._paths = {key: _inside(product.folder, name) for key, name in names.items() if name}
        self._lock = threading.RLock()
        self._surface = surface_of(product, options.surface) if product.job.is_stereo else None

    @cached_property
    def _images(self) -> dict[str, PyramidReader]:
        return {key: open_pyramid(path, nearest=key == "lineage") for key, path in self._paths.items()}

    @cached_property
    def _stretch(self) -> Stretch:
        return stretch_of(self._paths["ortho"])

    @cached_property
    def _tiles(self) -> dict[str, TileReader]:
        return {
            eye: TileReader(self._images[eye], self._stretch)
            for eye in ("ortho", "mate")
            if eye in self._images
        }

    @cached_property
    def _lattice(self) -> MeasuringLattice:
        return measuring_lattice(self.product.job)

    @cached_property
    def _heights(self) -> HeightWindow:
        return height_window(self.product.job, self._lattice)

    @cached_property
    def _record(self) -> dict[str, Any]:
        image = self._images["ortho"]
        return viewer_record(self.product, self.options.object_heights_m) | {
            "tiles": {
                "size": TILE,
                "apron": 1,
                "levels": image.levels(TILE),
                "format": self.options.format,
                "eyes": [eye for eye in ("ortho", "mate") if eye in self._paths],
                "stretch": {"low": self._stretch.low, "high": self._stretch.high},
            },
            "version": self._version(),
            "orientation_sigma": {
                "centre_m": self.options.centre_sigma_m,
                "angle_deg": self.options.angle_sigma_deg,
            },
            "objects": self._surface is not None,
            "points": read_points(self.options.points, self.product.job, self.product.folder),
            "title": self.options.title,
            "credits": self.options.credits,
        }

    def _version(self) -> str:
        """Changes with what files are made from: a browser takes none that it kept of others."""
        made_from = [__version__, product_key(self.product), repr(self.options)]
        if self._surface is not None:
            # places and sizes of all tiles stand at the beginning
            with self._surface.open("rb") as file:
                made_from.append(hashlib.sha256(file.read(_HEAD_BYTES)).hexdigest())
        return hashlib.sha256("\n".join(made_from).encode()).hexdigest()[:16]

    def names(self) -> Iterator[str]:
        """All files, in the order in which a page wants them."""
        yield "product.json"
        yield "measure.json"
        yield "lattice.bin"
        yield "relief.bin"
        yield from self._image_names()
        if "lineage" in self._paths:
            yield "lineage.bin"
            for col, row in _tile_range(self.product.job.grid.size, TILE):
                yield f"lineage/{col}_{row}.bin"
        for col, row in _tile_range((self._heights.cols, self._heights.rows), HEIGHT_TILE):
            yield f"heights/{col}_{row}.bin"
        if self._surface is not None:
            yield "objects.bin"
        if self.product.job.is_stereo:
            for index in range(len(self.options.object_heights_m)):
                yield f"homogeneity_{index}.bin"

    def _image_names(self) -> Iterator[str]:
        for level in reversed(range(self._images["ortho"].levels(TILE))):
            for eye in ("ortho", "mate"):
                if eye in self._images:
                    for col, row in _tile_range(self._images[eye].size(level), TILE):
                        yield f"{eye}/{level}/{col}_{row}.{self.options.format}"

    def read(self, name: str) -> bytes:
        """A file.

        Raises
        ------
        KeyError
            If there is none of that name.
        ImageError
            If a raster is damaged there.
        """
        simple: dict[str, Callable[[], bytes]] = {
            "product.json": self._product_json,
            "measure.json": self._measure_json,
            "lattice.bin": lambda: binary.encode_doubles(self._lattice_made().values),
            "relief.bin": lambda: binary.encode_floats(layers.relief(self.product.job)),
        }
        if "lineage" in self._paths:
            simple["lineage.bin"] = lambda: binary.encode_numbers(layers.lineage(self._image("lineage")))
        surface = self._surface
        if surface is not None:
            simple["objects.bin"] = lambda: binary.encode_floats(object_heights(self.product, surface))
        if name in simple:
            return simple[name]()
        if found := _EYE.fullmatch(name):
            return self._image_tile(found[1], name[-3:], (int(found[2]), int(found[3]), int(found[4])))
        if found := _PAIR.fullmatch(name):
            make = self._lineage_tile if found[1] == "lineage" else self._height_tile
            return make(int(found[2]), int(found[3]))
        if found := _HOMOGENEITY.fullmatch(name):
            return self._homogeneity(int(found[1]))
        raise KeyError(name)

    def _product_json(self) -> bytes:
        with self._lock:
            return json.dumps(self._record, ensure_ascii=False, allow_nan=False).encode()

    def _measure_json(self) -> bytes:
        with self._lock:
            record = measuring_record(self.product, self._lattice, self._heights)
        return json.dumps(record, ensure_ascii=False, allow_nan=False).encode()

    def _lattice_made(self) -> MeasuringLattice:
        with self._lock:
            return self._lattice

    def first(self) -> Iterator[str]:
        """What the first picture is made of."""
        yield "product.json"
        version, top = self._version(), self._image("ortho").levels(TILE) - 1
        for eye in ("ortho", "mate"):
            if eye in self._paths:
                yield f"{eye}/{top}/0_0.{self.options.format}?v={version}"

    def _image(self, key: str) -> PyramidReader:
        with self._lock:
            return self._images[key]

    def _image_tile(self, eye: str, suffix: str, place: tuple[int, int, int]) -> bytes:
        image = self._image(eye) if eye in self._paths else None
        if image is None or suffix != self.options.format or place[0] >= image.levels(TILE):
            raise KeyError((eye, *place))
        with self._lock:
            tiles = self._tiles[eye]
        return encode_image(tiles.read(*place), self.options.format, self.options.quality)

    def _lineage_tile(self, col: int, row: int) -> bytes:
        """Numbers of the photographs of orthophoto and stereomate, tile after tile."""
        if "lineage" not in self._paths:
            raise KeyError((col, row))
        pixels, valid, window = self._image("lineage").read(0, col * TILE, row * TILE, TILE, TILE)
        if window.is_empty:
            raise KeyError((col, row))
        pixels[~valid] = 0
        return binary.encode_numbers(np.moveaxis(pixels, -1, 0))

    def _height_tile(self, col: int, row: int) -> bytes:
        with self._lock:
            window = self._heights
        col0, row0 = col * HEIGHT_TILE, row * HEIGHT_TILE
        if not (col0 < window.cols and row0 < window.rows):
            raise KeyError((col, row))
        patch = self.product.job.heights.patch(
            window.col0 + col0,
            window.row0 + row0,
            min(HEIGHT_TILE, window.cols - col0),
            min(HEIGHT_TILE, window.rows - row0),
        )
        return binary.encode_floats(patch.heights)

    def _homogeneity(self, index: int) -> bytes:
        heights = self.options.object_heights_m
        if not self.product.job.is_stereo or index >= len(heights):
            raise KeyError(index)
        return binary.encode_floats(layers.homogeneity(self.product.job, heights[index]))

    def close(self) -> None:
        """Close the rasters."""
        with self._lock:
            self.__dict__.pop("_tiles", None)
            for image in self.__dict__.pop("_images", {}).values():
                image.close()


class Site:
    """The files of a viewer: page code, the list of products, and each product under ``data/NUMBER``."""

    def __init__(self, products: list[StereoProduct], options: SiteOptions | None = None) -> None:
        self.options = options or SiteOptions()
        self.sources = [ProductSource(product, self.options) for product in products]

    def names(self) -> Iterator[str]:
        """All files."""
        yield from page_names()
        yield "data/products.json"
        for index, source in enumerate(self.sources):
            for name in source.names():
                yield f"data/{index}/{name}"

    def read(self, name: str) -> bytes:
        """A file.

        Raises
        ------
        KeyError
            If there is none of that name.
        """
        if name == "data/products.json":
            return json.dumps(self._list(), ensure_ascii=False).encode()
        parts = name.split("/", 2)
        if parts[0] == "data" and len(parts) == 3:
            if not (parts[1].isdecimal() and len(parts[1]) < 6 and int(parts[1]) < len(self.sources)):
                raise KeyError(name)
            return self.sources[int(parts[1])].read(parts[2])
        return read_page(name, self._first() if name == "index.html" else ())

    def _first(self) -> tuple[str, ...]:
        """What a page wants at once, if it is not told to show another product."""
        names = (f"data/0/{name}" for source in self.sources[:1] for name in source.first())
        return ("data/products.json", *names)

    def prepare(self) -> None:
        """Make what the first picture waits for."""
        for name in page_names():
            self.read(name)
        for source in self.sources:
            source.read("product.json")

    def verify(self) -> None:
        """Compare hashes of rasters and height models.

        Raises
        ------
        FormatError, InputError
            As `StereoProduct.verify`.
        """
        for source in self.sources:
            source.product.verify()

    def _list(self) -> dict[str, Any]:
        jobs = [source.product.job for source in self.sources]
        return {
            "format": PAGE.version,
            "products": [
                {"name": job.name or "product", "folder": str(k), "stereo": job.is_stereo}
                for k, job in enumerate(jobs)
            ],
        }

    def close(self) -> None:
        """Close all rasters."""
        for source in self.sources:
            source.close()


class KeptSite:
    """A site whose files are kept for a while once they are made: what a server gives to many clients."""

    def __init__(self, site: Site) -> None:
        self._site, self._kept = site, Kept[str, bytes](len)

    def read(self, name: str) -> bytes:
        """As `Site.read`."""
        return self._kept.get(name, self._site.read)


def _inside(folder: Path, name: str) -> Path:
    """A file of a product, which must lie in its folder: stereo.json may have come from anywhere."""
    path = folder / name
    if not path.is_file():
        raise FormatError("does not exist", file=path)
    if not path.resolve().is_relative_to(folder.resolve()):
        raise FormatError("must lie in the folder of the product", file=path)
    return path


def _tile_range(size: tuple[int, int], tile: int) -> Iterator[tuple[int, int]]:
    for row in range(-(-size[1] // tile)):
        for col in range(-(-size[0] // tile)):
            yield col, row
