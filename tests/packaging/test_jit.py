"""The cache of compiled kernels: named after everything that a kernel is made of."""

import subprocess
import sys

from stereomate import jit

CALLER = """
from stereomate.jit import kernel
from stereomate.twice.kernels.inner import twice

@kernel
def four(x):
    return twice(twice(x))
"""
INNER = """
from stereomate.jit import kernel

@kernel
def twice(x):
    return {factor} * x
"""


def test_a_kernel_is_known_by_its_file_and_all_that_it_imports(monkeypatch, tmp_path):
    folder = tmp_path / "stereomate" / "twice" / "kernels"
    folder.mkdir(parents=True)
    (folder / "inner.py").write_text(INNER.format(factor=2.0))
    (folder / "outer.py").write_text(CALLER)
    (folder / "other.py").write_text("from stereomate.jit import kernel\n")
    monkeypatch.setattr(jit, "_PACKAGE", tmp_path / "stereomate")

    def keys():
        jit.cache_key.cache_clear()
        jit._imported.cache_clear()
        return {name: jit.cache_key(folder / f"{name}.py") for name in ("inner", "outer", "other")}

    before = keys()
    (folder / "inner.py").write_text(INNER.format(factor=3.0))
    after = keys()
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"inner", "outer"}
    jit.cache_key.cache_clear()
    jit._imported.cache_clear()


def test_numba_itself_is_left_as_it_was():
    code = """
import numba
before = numba.config.CACHE_DIR
import stereomate.camera.kernels
assert numba.config.CACHE_DIR == before
"""
    subprocess.run([sys.executable, "-c", code], check=True)
