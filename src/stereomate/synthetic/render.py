"""Photographs of a synthetic world, ray by ray."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.coverage.survey import Photograph
from stereomate.synthetic.kernels.curve import shift_terms
from stereomate.synthetic.kernels.render import edge_pixels, rays_inside_pixels, shade_rays
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.world import SyntheticWorld
from stereomate.tiles.executor import Executor, map_items

Array = NDArray[np.float64]

_BAND_ROWS: Final = 64


@dataclass(frozen=True, eq=False)
class _Band:
    """Rows first..last of one photograph."""

    world: SyntheticWorld
    photograph: Photograph
    number: int
    first: int
    last: int


def render_photograph(
    world: SyntheticWorld, photograph: Photograph, number: int, executor: Executor | None = None
) -> NDArray[np.uint8]:
    """The image (rows, cols, 3) that a camera takes of the world.

    One ray in the middle of every pixel, `options.samples` squared where surfaces or shadows meet. Exposure
    and sensor noise follow from the seed of the world and the number of the photograph, whoever renders it.

    Parameters
    ----------
    number : int
        Of the photograph in its survey.
    executor : Executor, optional
        Where bands of rows are rendered; one thread without.
    """
    rows = photograph.camera.size_px[1]
    bands = [
        _Band(world, photograph, number, first, min(first + _BAND_ROWS, rows))
        for first in range(0, rows, _BAND_ROWS)
    ]
    return np.concatenate(map_items(_render_band, bands, executor))


def camera_rays(photograph: Photograph, first: int, last: int) -> Array:
    """Rays (rows, cols, 3) of the pixel centres of rows first..last, tangent frame, not of unit length."""
    cols = photograph.camera.size_px[0]
    row, col = np.mgrid[first:last, :cols]
    rays = photograph.camera.rays_from_image(np.stack([col + 0.5, row + 0.5], axis=-1))
    return np.ascontiguousarray(rays @ photograph.orientation.object_from_camera.T)


def _render_band(band: _Band) -> NDArray[np.uint8]:
    rows = band.photograph.camera.size_px[1]
    upper, lower = max(band.first - 1, 0), min(band.last + 1, rows)
    rays = camera_rays(band.photograph, upper, lower)
    polynomial = band.world.polynomial
    shifted = shift_terms(
        polynomial.exponents, polynomial.terms, polynomial.scale, *band.photograph.orientation.centre
    )
    colours, surfaces, distances = _shaded(band.world, shifted, rays.reshape(-1, 3))
    shape = rays.shape[:2]
    colours, surfaces, distances = (
        colours.reshape(rays.shape),
        surfaces.reshape(shape),
        distances.reshape(shape),
    )
    found = np.empty((shape[0] * shape[1], 2), dtype=np.int64)
    count = edge_pixels(surfaces, distances, band.first - upper, band.last - upper, found)
    samples = band.world.options.samples
    if count and samples > 1:
        edges = np.ascontiguousarray(found[:count])
        inner = np.empty((count * samples * samples, 3))
        rays_inside_pixels(rays, edges, samples, inner)
        fine, _, _ = _shaded(band.world, shifted, inner)
        colours[edges[:, 0], edges[:, 1]] = fine.reshape(count, samples * samples, 3).mean(axis=1)
    return _exposed(band, colours[band.first - upper : band.last - upper])


def _shaded(world: SyntheticWorld, shifted: Array, rays: Array) -> tuple[Array, NDArray[np.int64], Array]:
    colours, distances = np.empty(rays.shape), np.empty(len(rays))
    surfaces = np.empty(len(rays), dtype=np.int64)
    shade_rays(world.polynomial.exponents, shifted, rays, *world.scene, colours, surfaces, distances)
    return colours, surfaces, distances


def light_of_photograph(
    options: SurveyOptions, size_px: tuple[int, int], number: int, first: int, last: int
) -> Array:
    """What colours are multiplied by in rows first..last of a photograph, (rows, cols, 3)."""
    cols, rows = size_px
    rng = np.random.default_rng([options.seed, 11, number])
    gain = 1.0 + options.exposure_sigma * rng.standard_normal()
    colour = 1.0 + options.colour_sigma * rng.standard_normal(3)
    gradient = options.gradient_sigma * rng.standard_normal((2, 3))
    x = ((np.arange(cols) + 0.5 - 0.5 * cols) / (0.5 * cols))[None, :, None]
    y = ((np.arange(first, last) + 0.5 - 0.5 * rows) / (0.5 * rows))[:, None, None]
    fall = 1.0 - 0.5 * options.vignetting * (x**2 + y**2)
    return np.asarray(gain * colour * (1.0 + gradient[0] * x + gradient[1] * y) * fall)


def _exposed(band: _Band, colours: Array) -> NDArray[np.uint8]:
    """Digital numbers: vignetting, exposure of the photograph, noise of the sensor."""
    options = band.world.options
    light = light_of_photograph(options, band.photograph.camera.size_px, band.number, band.first, band.last)
    signal = (colours * light).astype(np.float32)
    if options.noise_dn > 0.0:
        rng = np.random.default_rng([options.seed, 12, band.number, band.first])
        signal += np.float32(options.noise_dn) * rng.standard_normal(signal.shape, dtype=np.float32)
    # never 0: photographs have no nodata, and black stays told from it
    return np.clip(np.rint(signal), 1, 255).astype(np.uint8)
