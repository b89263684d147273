"""Makes the pictures of the tutorial on georeferencing: ``python docs/make_georeferencing_pictures.py``.

They are what its commands draw.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2

DOCS = Path(__file__).parent
LIMIT_BYTES = 200_000


def main() -> None:
    """Run the tested blocks of the page and keep its figures."""
    page = (DOCS / "georeferencing.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        for language, text in re.findall(
            r"<!-- tested -->\n```(\w+)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL
        ):
            if language == "python":
                subprocess.run([sys.executable, "-c", text], cwd=folder, check=True)
            else:
                for line in re.findall(r"^\$ (.*)$", text, re.MULTILINE):
                    words = [sys.executable, "-m", *shlex.split(line)]
                    subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL)
        for name in ("predict", "audit"):
            picture = cv2.imread(str(Path(folder) / f"{name}.png"))
            half = cv2.resize(picture, None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA)
            out = DOCS / "pictures" / f"georef_{name}.png"
            cv2.imwrite(str(out), half, [cv2.IMWRITE_PNG_COMPRESSION, 9])
            if out.stat().st_size > LIMIT_BYTES:
                raise SystemExit(f"{out} is larger than {LIMIT_BYTES} bytes")


if __name__ == "__main__":
    main()
