"""A small product, its server, and a browser: made once for all tests of the viewer."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from browsing import SURVEY, Opened, serving

from stereomate.stereo.product import StereoProduct
from stereomate.viewer.site import Site, SiteOptions

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "project"))


@pytest.fixture(scope="session")
def survey_folder(tmp_path_factory) -> Path:
    from run_survey import write_tiny

    return write_tiny(tmp_path_factory.mktemp("survey"), **SURVEY).parent


@pytest.fixture(scope="session")
def run_folder(survey_folder) -> Path:
    """The products; the folder's name has a space and letters beyond ASCII."""
    from run_survey import make

    out = survey_folder / "Größe 1 – prodükte"
    make(survey_folder / "project.toml", out, agreement=False, threads=1)
    return out


@pytest.fixture(scope="session")
def product(run_folder) -> StereoProduct:
    return StereoProduct.open(run_folder, verify=False)


@pytest.fixture(scope="session")
def site(product) -> Iterator[Site]:
    made = Site([product], SiteOptions(title="Test block", credits="Synthetic"))
    yield made
    made.close()


@pytest.fixture(scope="session")
def address(site) -> Iterator[str]:
    with serving(site) as found:
        yield found


@pytest.fixture
def opened(browser):
    context = browser.new_context(viewport={"width": 800, "height": 600})
    yield Opened(context.new_page())
    context.close()
