"""A surface of objects as `stereomate heights` writes it, of given values."""

from __future__ import annotations

from stereomate.raster.cog import Georeference, assemble_cog, encode_chunk
from stereomate.stereo.matched_surface import surface_profile
from stereomate.stereo.surface_bands import ORTHO_TAG
from stereomate.tiles.plan import TilePlan


def write_surface_file(product, path, values, step, ortho=None):
    """Write `values` (rows, cols, bands) on cells of `step` pixels; they must fit one chunk."""
    grid, plan = product.job.grid, TilePlan((values.shape[1], values.shape[0]), 512, 2)
    (chunk,) = plan.chunks
    blob = encode_chunk(surface_profile(), plan, values)

    class Blob:
        def read(self, index, name, offset, size):
            assert index == chunk.index
            return blob[offset : offset + size]

    a, b, x, d, e, y = grid.affine
    tags = {ORTHO_TAG: ortho or product.files.hashes["ortho.tif"]}
    place = Georeference(product.job.frame.crs, (a * step, b * step, x, d * step, e * step, y), tags)
    assemble_cog(path, surface_profile(), plan, Blob(), "surface", place)
