"""What a run loads before it begins: libraries that only some runs need load when they are used."""

import subprocess
import sys


def test_a_run_starts_without_what_it_may_not_need():
    code = "import sys, stereomate.project.run; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    loaded = set(done.stdout.split())
    assert "numba" in loaded
    rare = {"scipy.linalg", "scipy.sparse", "scipy.spatial", "scipy.stats", "scipy.ndimage", "scipy.optimize"}
    rare |= {"matplotlib", "pyogrio", "pyarrow", "jinja2", "pandas", "geopandas", "dask", "rich.progress"}
    assert not loaded & rare
