"""One thread per task: threads that libraries start inside tasks only get in each other's way."""

from __future__ import annotations

import ctypes
import importlib.util
import os
import sys
from pathlib import Path
from typing import Final

# Setters of the OpenBLAS builds that come inside the wheels of numpy and scipy.
_OPENBLAS_SETTERS: Final = (
    "scipy_openblas_set_num_threads64_",
    "scipy_openblas_set_num_threads",
    "openblas_set_num_threads64_",
    "openblas_set_num_threads",
)


def limit_library_threads() -> None:
    """Let OpenCV and OpenBLAS run one thread in this process: those loaded, and those loaded later."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ[name] = "1"
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
    for library in _loaded_openblas():
        for name in _OPENBLAS_SETTERS:
            setter = getattr(library, name, None)
            if setter is not None:
                setter(1)
                break


def _loaded_openblas() -> list[ctypes.CDLL]:
    """OpenBLAS libraries already in this process; nothing is loaded here."""
    if not hasattr(os, "RTLD_NOLOAD"):
        return []
    found = []
    for package in ("numpy", "scipy"):
        spec = importlib.util.find_spec(package)
        if package not in sys.modules or spec is None or spec.origin is None:
            continue
        folder = Path(spec.origin).parents[1] / f"{package}.libs"
        for path in sorted(folder.glob("*openblas*")):
            try:
                found.append(ctypes.CDLL(str(path), mode=os.RTLD_NOLOAD))
            except OSError:
                continue
    return found
