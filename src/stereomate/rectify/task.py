"""One chunk of a product as the tile engine runs it: rectified, encoded once, returned as blobs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

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
        blobs[LINEAGE] = _encoded_lineage(lineage_profile(self.job), self.plan, parts)
        return blobs

    def _encoded(self, part: Part) -> bytes:
        return encode_chunk(self.profile, self.plan, part.pixels, part.valid != 0)


def _encoded_lineage(profile: CogProfile, plan: TilePlan, parts: list[Part]) -> bytes:
    lineage = np.stack([part.photograph for part in parts], axis=-1)
    photographs = lineage[0, 0]
    if (lineage == photographs).all():
        return _encoded_alike(profile, plan, lineage.shape[:2], tuple(int(p) for p in photographs))
    return encode_chunk(profile, plan, lineage)


@lru_cache(maxsize=64)
def _encoded_alike(
    profile: CogProfile, plan: TilePlan, shape: tuple[int, int], photographs: tuple[int, ...]
) -> bytes:
    """The lineage of a chunk all from the same photographs: most chunks are, and nothing else decides it."""
    return encode_chunk(profile, plan, np.full((*shape, len(photographs)), photographs, np.uint16))
