"""The wheel is whole: built, installed in a clean environment outside the source tree, and run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from pages import ROOT

pytestmark = pytest.mark.wheel

NO_CODE = {".pyc"}


def call(*arguments: object, cwd: Path, **environment: str) -> str:
    """Output of a command that must succeed, in a folder that is not the repository."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(
        [str(a) for a in arguments],
        cwd=cwd,
        env={**clean, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, f"{arguments}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built from a copy: setuptools leaves folders beside the sources."""
    folder = tmp_path_factory.mktemp("build")
    source = folder / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(ROOT / name, source)
    ignored = shutil.ignore_patterns("__pycache__", "*.egg-info")
    shutil.copytree(ROOT / "src", source / "src", ignore=ignored)
    call(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, source, cwd=folder)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def clean_python(wheel: Path, tmp_path_factory) -> Path:
    """Python of a new environment with the wheel alone; the dependencies of this one are lent by a path file.

    Path files inside a lent folder are not read, so an editable installation of the sources stays out.
    """
    folder = tmp_path_factory.mktemp("clean")
    venv.create(folder, with_pip=False)
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    site = Path(
        call(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip()
    )
    call(sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "--python", python, "install",
         "--no-deps", "--no-index", wheel, cwd=folder)  # fmt: skip
    lent = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "lent.pth").write_text("".join(f"{path}\n" for path in sorted(lent)))
    return python


def test_every_file_of_the_package_is_inside(wheel):
    source = ROOT / "src" / "stereomate"
    wanted = {
        f"stereomate/{path.relative_to(source).as_posix()}"
        for path in source.rglob("*")
        if path.is_file() and path.suffix not in NO_CODE and "__pycache__" not in path.parts
    }
    with zipfile.ZipFile(wheel) as archive:
        inside = set(archive.namelist())
    assert wanted - inside == set()
    assert {"stereomate/py.typed", "stereomate/report/templates/run.html"} <= inside
    assert any(name.endswith(".js") for name in inside)
    others = {name for name in inside - wanted if ".dist-info/" not in name}
    assert others == set()
    assert any(name.endswith("licenses/NOTICE") for name in inside)


def test_the_command_runs_outside_the_sources(clean_python, tmp_path):
    where = call(clean_python, "-c", "import stereomate; print(stereomate.__file__)", cwd=tmp_path).strip()
    assert Path(where).is_relative_to(clean_python.parents[1])
    command = clean_python.parent / "stereomate"
    import stereomate

    assert call(command, "--version", cwd=tmp_path).strip() == f"stereomate {stereomate.__version__}"
    helped = call(command, "--help", cwd=tmp_path)
    for name in ("init", "check", "run", "demo"):
        assert f"\n  {name} " in helped


def test_it_imports_and_computes_outside_the_sources(clean_python, tmp_path):
    """Kernels compile, and a report's template is found."""
    out = call(
        clean_python,
        "-c",
        "import stereomate\n"
        "from stereomate.report.overcorrection_interactive import interactive_page\n"
        "from stereomate.relative.drawing import section_drawing\n"
        "print(round(float(stereomate.overcorrection_factor([[0, 1500], [750, 1500], [-750, 1500]])), 3))\n",
        cwd=tmp_path,
        STEREOMATE_CACHE=str(tmp_path / "cache"),
    )
    assert out.strip() == "2.5"


def test_every_module_imports_outside_the_sources(clean_python, tmp_path):
    """Extras are imported where they are used, so that no module needs one to be imported."""
    program = (
        "import importlib, pkgutil, stereomate\n"
        "names = [m.name for m in pkgutil.walk_packages(stereomate.__path__, 'stereomate.')]\n"
        "[importlib.import_module(n) for n in names if not n.endswith('__main__')]\n"
        "import sys\n"
        "extras = {'distributed', 'dask', 'laspy', 'pyopf', 'pycolmap'}\n"
        "print(len(names), sorted(extras & set(sys.modules)))\n"
    )
    count, extras = call(clean_python, "-c", program, cwd=tmp_path).strip().split(" ", 1)
    assert int(count) > 100
    assert extras == "[]"
