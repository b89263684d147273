"""Reading rasters by windows and writing Cloud Optimized GeoTIFFs; the only folder that imports rasterio."""

from stereomate.raster.heights import HeightReader, HeightScale, open_heights
from stereomate.raster.info import RasterInfo
from stereomate.raster.reader import PhotoReader, open_photo
from stereomate.raster.settings import Resources, configure, current, give_back_memory
from stereomate.raster.windows import Window

__all__ = [
    "HeightReader",
    "HeightScale",
    "PhotoReader",
    "RasterInfo",
    "Resources",
    "Window",
    "configure",
    "current",
    "give_back_memory",
    "open_heights",
    "open_photo",
]
