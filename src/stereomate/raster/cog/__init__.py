"""Cloud Optimized GeoTIFFs: tiles are encoded once, by their task, and assembled from a ledger."""

from stereomate.raster.cog.assemble import assemble_cog
from stereomate.raster.cog.encode import encode_chunk
from stereomate.raster.cog.georeference import Georeference
from stereomate.raster.cog.profile import CogProfile
from stereomate.raster.cog.statistics import BandStatistics

__all__ = ["BandStatistics", "CogProfile", "Georeference", "assemble_cog", "encode_chunk"]
