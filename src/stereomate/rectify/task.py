"""One chunk of a product as the tile engine runs it: rectified, encoded once, returned as blobs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereomate.raster.cog import CogProfile, encode_chunk
from stereomate.rectify.engine import Part, rectify_window
from stereomate.rectify.job import RectifyJob
from stereomate.tiles.plan import Chunk, TilePlan

ORTHO, MATE, LINEAGE = "ortho", "mate", "lineage"

# Bands of the lineage raster.
LINEAGE_BANDS = ("photograph of the orthophoto", "photograph of the stereomate")


def product_profile(job: RectifyJob, roles: tuple[str, ...] = ()) -> CogProfile:
    """How orthophoto and stereomate are written."""
    options = job.options
    dtype = str(job.dtype)
    nodata = options.nodata
    if nodata is None and options.masking != "mask" and (dtype == "float32" or options.masking == "nodata"):
        nodata = float("nan") if dtype == "float32" else 0.0
    lossy = options.compression in ("jpeg", "webp")
    return CogProfile(
        dtype=dtype,
        bands=len(job.bands),
        nodata=nodata,
        mask=nodata is None,
        compression=options.compression,
        level=options.quality if lossy else options.compression_level,
        roles=roles,
    )


def lineage_profile(job: RectifyJob) -> CogProfile:
    """How the lineage is written: photographs counted from 1, 0 for none."""
    bands = 2 if job.is_stereo else 1
    return CogProfile(
        dtype="uint16",
        bands=bands,
        nodata=0.0,
        compression="zstd",
        overviews="nearest",
        roles=("gray", "undefined")[:bands],
        descriptions=LINEAGE_BANDS[:bands],
        statistics=False,
    )


@dataclass(frozen=True, eq=False)
class ChunkTask:
    """Makes the blobs of a chunk: `ortho`, `mate` and `lineage`. Picklable."""

    job: RectifyJob
    plan: TilePlan
    profile: CogProfile

    def __call__(self, chunk: Chunk) -> dict[str, bytes]:
        """Rectify and encode one chunk."""
        ortho, mate = rectify_window(self.job, chunk.window)
        blobs = {ORTHO: self._encoded(ortho)}
        parts = [ortho]
        if mate is not None:
            blobs[MATE] = self._encoded(mate)
            parts.append(mate)
        lineage = np.stack([part.photograph for part in parts], axis=-1)
        blobs[LINEAGE] = encode_chunk(lineage_profile(self.job), self.plan, lineage)
        return blobs

    def _encoded(self, part: Part) -> bytes:
        return encode_chunk(self.profile, self.plan, part.pixels, part.valid != 0)
