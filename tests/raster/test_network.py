"""Nothing that GDAL is told by a file makes it ask the network."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

VRT = """<VRTDataset rasterXSize="64" rasterYSize="64"><VRTRasterBand dataType="Byte" band="1"><SimpleSource>
<SourceFilename relativeToVRT="0">/vsicurl/{url}/secret.tif</SourceFilename><SourceBand>1</SourceBand>
</SimpleSource></VRTRasterBand></VRTDataset>"""
WMS = """<GDAL_WMS><Service name="TMS"><ServerUrl>{url}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>
<DataWindow><UpperLeftX>0</UpperLeftX><UpperLeftY>64</UpperLeftY><LowerRightX>64</LowerRightX>
<LowerRightY>0</LowerRightY><TileLevel>0</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY>
</DataWindow><BlockSizeX>64</BlockSizeX><BlockSizeY>64</BlockSizeY><BandsCount>1</BandsCount></GDAL_WMS>"""

# GDAL registers its drivers once in a process: each question is asked in a fresh one.
CAREFUL = """
import sys
from stereomate.errors import ImageError
from stereomate.raster import open_photo
try:
    with open_photo(sys.argv[1]) as photo:
        photo.read_window(0, 0, 64, 64)
except ImageError as error:
    print(error)
"""
CARELESS = """
import sys, rasterio
try:
    rasterio.open(sys.argv[1]).read()
except rasterio.errors.RasterioError as error:
    print(error)
"""


@pytest.fixture
def asked() -> Iterator[tuple[str, list[str]]]:
    """Address of a server on this machine, and the paths it was asked for."""
    paths: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            paths.append(self.path)
            self.send_error(404)

        do_HEAD = do_GET

        def log_message(self, *args: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", paths
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("text", [VRT, WMS], ids=["VRT", "WMS"])
def test_a_file_that_points_to_the_network_is_refused_without_asking(tmp_path, asked, text):
    url, paths = asked
    file = tmp_path / "photo.vrt"
    file.write_text(text.format(url=url))
    out = subprocess.run(
        [sys.executable, "-c", CAREFUL, str(file)], capture_output=True, text=True, check=True
    )
    assert "photo.vrt: cannot be read" in out.stdout
    assert paths == []
    # The same file does reach the network when nobody is careful, or the test would show nothing.
    subprocess.run(
        [sys.executable, "-W", "ignore", "-c", CARELESS, str(file)],
        capture_output=True,
        check=True,
        # Without what careful code has put into the environment of this process.
        env={k: v for k, v in os.environ.items() if not k.startswith(("GDAL_", "CPL_", "PROJ_"))},
    )
    assert paths
