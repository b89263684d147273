"""The page's own exact measuring against Python's, in a real browser."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from browsing import SURVEY, serving

from stereomate.coverage.covariance import OrientationCovariance
from stereomate.stereo.measured import Flag, MeasureOptions
from stereomate.stereo.product import StereoProduct
from stereomate.terrain.model import HeightModel
from stereomate.viewer.site import Site

MEASURE = """async ([base, pairs, accuracy]) => {
  const { Product } = await import(base + 'product.js');
  const product = await Product.open(base + 'data/0');
  const out = [];
  for (const [left, right] of pairs) {
    const m = await product.measure(left, right, accuracy);
    out.push({ point: m.point, sigma: m.sigma, covariance: m.covariance,
               orientation: m.orientationCovariance, law: m.lawHeight, flags: m.flags,
               photographs: m.photographs, miss: m.miss, y: m.yParallax, degrees: m.degrees,
               standardized: m.standardized, ground: m.groundHeight });
  }
  return out;
}"""


# 0.3 pixels, and orientations as a good block has them.
ACCURACY = MeasureOptions(sigma_px=0.3, centre_sigma_m=0.03, angle_sigma_rad=5e-5)


def in_page(browser, address, pairs, stated=ACCURACY):
    page = browser.new_page()
    page.goto(address + "product.js")
    accuracy = {
        "px": stated.sigma_px,
        "centre": stated.centre_sigma_m,
        "angle": stated.angle_sigma_rad,
    }
    found = page.evaluate(MEASURE, [address, [[a.tolist(), b.tolist()] for a, b in pairs], accuracy])
    page.close()
    return found


def random_pairs(job, count, seed):
    """Positions all over the product, objects from 3 m below the ground to 15 m above it, and a little y."""
    rng = np.random.default_rng(seed)
    left = rng.uniform((0.0, 0.0), job.grid.size, (count, 2))
    height = rng.uniform(*job.height_range, count) + rng.uniform(-3.0, 15.0, count)
    right = left - np.column_stack([job.law.q(height) / job.grid.gsd, rng.normal(0.0, 0.3, count)])
    return left, right


@pytest.fixture(scope="module")
def both(product, browser, address):
    job = product.job
    left, right = random_pairs(job, 250, 1)
    python = product.measure(job.grid.map_from_pixel(left), job.grid.map_from_pixel(right), ACCURACY)
    return python, in_page(browser, address, list(zip(left, right, strict=True)))


def test_points_equal_python(both):
    python, page = both
    measured = python.measured
    assert measured.sum() > 60
    assert [m["point"] is not None for m in page] == measured.tolist()
    points = np.array([m["point"] for m in page if m["point"]])
    print("largest difference, m:", np.abs(points - python.points[measured]).max(axis=0))
    np.testing.assert_allclose(points, python.points[measured], atol=5e-4)
    sigma = np.array([m["sigma"] for m in page if m["point"]])
    np.testing.assert_allclose(sigma, python.sigma[measured], rtol=1e-4)
    covariance = np.array([m["covariance"] for m in page if m["point"]])
    scale = np.sqrt(np.einsum("nii,njj->nij", python.covariance[measured], python.covariance[measured]))
    np.testing.assert_allclose(covariance / scale, python.covariance[measured] / scale, atol=1e-4)
    orientation = np.array([m["orientation"] for m in page if m["point"]])
    share = python.orientation_covariance[measured]
    scale = np.sqrt(np.einsum("nii,njj->nij", share, share))
    assert (scale > 0.0).all()
    np.testing.assert_allclose(orientation / scale, share / scale, atol=1e-4)
    miss = np.array([m["miss"] for m in page if m["point"]])
    np.testing.assert_allclose(miss, python.miss_m[measured], atol=1e-4)


def test_flags_and_lineage_equal_python(both):
    python, page = both
    np.testing.assert_array_equal([m["photographs"] for m in page], python.photographs)
    np.testing.assert_array_equal([m["flags"] for m in page], python.flags)
    measured = python.measured
    law = np.array([m["law"] for m in page])[measured]
    np.testing.assert_allclose(law, python.law_heights[measured], atol=1e-9)


def known_orientations(job):
    """Covariances of an adjustment that left the last pair of photographs out."""
    names = [photograph.name for photograph in job.photographs]
    factor = np.random.default_rng(6).normal(0.0, 1.0, (6 * len(names), 80))
    factor[:, :40] = np.tile(factor[:6, :40], (len(names), 1))
    whole = np.tile([0.02] * 3 + [4e-5] * 3, len(names))[:, None] * factor / 9.0
    block = {k: whole[6 * k : 6 * k + 6] for k in range(len(names))}
    pairs = {(names[b], names[a]): block[b] @ block[a].T for b in block for a in range(b)}
    pairs.pop((names[-1], names[-2]))
    return OrientationCovariance({names[k]: block[k] @ block[k].T for k in block}, pairs)


def test_hidden_ground_and_known_orientations_equal_python(product, browser):
    """Walls in the height model hide ground behind them: from the same photographs in page and Python. The
    accuracy of the orientation is that of the product, where it has it."""
    job = product.job
    rows, cols = job.heights.shape
    heights = np.array(job.heights.patch(0, 0, cols, rows).heights)
    heights[:, np.arange(cols) // 4 % 3 == 0] += 60.0
    heights[np.arange(rows) // 5 % 3 == 0] += 30.0
    walled = dataclasses.replace(
        job,
        heights=HeightModel.from_array(heights, job.heights.affine, job.heights.frame),
        height_range=(job.height_range[0], job.height_range[1] + 90.0),
    )
    product = dataclasses.replace(product, job=walled, orientation=known_orientations(job))
    left, right = random_pairs(walled, 200, 3)
    options = MeasureOptions(sigma_px=0.3)
    python = product.measure(job.grid.map_from_pixel(left), job.grid.map_from_pixel(right), options)
    site = Site([product])
    with serving(site) as address:
        page = in_page(browser, address, list(zip(left, right, strict=True)), options)
    site.close()
    share = python.orientation_covariance
    known = np.isfinite(share).all(axis=(1, 2)) & python.measured
    assert 5 < known.sum() < python.measured.sum()
    assert [m["orientation"] is not None for m in page] == known.tolist()
    found = np.array([m["orientation"] for m in page if m["orientation"]])
    scale = np.sqrt(np.einsum("nii,njj->nij", share[known], share[known]))
    np.testing.assert_allclose(found / scale, share[known] / scale, atol=1e-4)
    hidden = (python.flags & int(Flag.HIDDEN)) != 0
    print(hidden.sum(), "of", python.measured.sum(), "points on hidden ground")
    assert 10 < hidden.sum() < python.measured.sum() - 10
    np.testing.assert_array_equal([m["flags"] for m in page], python.flags)


@pytest.mark.slow
def test_rotated_grid_other_law_and_bicubic_heights(browser, tmp_path):
    """Another product: rows along a base 35 degrees off, natural law, bicubic heights."""
    from run_survey import make, write_tiny

    project = write_tiny(tmp_path / "survey", **SURVEY, heading_deg=55.0)
    text = project.read_text().replace('"logarithmic"', '"natural"')
    assert text.endswith('law = "natural"\n')
    project.write_text(text + 'heights_interpolation = "cubic"\n')
    make(project, tmp_path / "out", agreement=False, threads=1)
    product = StereoProduct.open(tmp_path / "out", verify=False)
    job = product.job
    assert abs(job.grid.rotation) > 0.3
    left, right = random_pairs(job, 120, 2)
    python = product.measure(job.grid.map_from_pixel(left), job.grid.map_from_pixel(right), ACCURACY)
    site = Site([product])
    with serving(site) as address:
        page = in_page(browser, address, list(zip(left, right, strict=True)))
    site.close()
    measured = python.measured
    assert measured.sum() > 20
    points = np.array([m["point"] for m in page if m["point"]])
    np.testing.assert_allclose(points, python.points[measured], atol=5e-4)
    sigma = np.array([m["sigma"] for m in page if m["point"]])
    np.testing.assert_allclose(sigma, python.sigma[measured], rtol=1e-4)
    np.testing.assert_array_equal([m["flags"] for m in page], python.flags)
