"""Forward intersection of a real block against the coordinates its owner published."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.geometry.intersection import Rays, intersect_rays
from stereomate.geometry.rotations import rotation_from_opk

# Camera1.txt: principal point and principal distance in pixels.
FOCAL_PX, PRINCIPAL_PX = 30975.0, np.array([13210.0, 8502.0])


def _observations(path):
    rows = [line.replace('"', "").split() for line in path.read_text().splitlines() if line.strip()]
    return [(row[0], row[1]) for row in rows], np.array([[float(v) for v in row[2:4]] for row in rows])


def _geoid(path, longitude, latitude):
    import rasterio

    with rasterio.open(path) as grid:
        values = grid.read(1)
        column, row = ~grid.transform @ (longitude, latitude)
        column, row = column - 0.5, row - 0.5
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    a, b = row - i, column - j
    return (
        values[i, j] * (1 - a) * (1 - b) + values[i, j + 1] * (1 - a) * b
        + values[i + 1, j] * a * (1 - b) + values[i + 1, j + 1] * a * b
    )  # fmt: skip


@pytest.mark.real
def test_ign_borea_in_the_grid_taken_as_cartesian(data_folder):
    """The block was adjusted in the grid: there its own ground coordinates come back to centimetres.

    The rigorous ways through the tangent frame are tests of the frames.
    """
    from pyproj import Transformer

    folder = data_folder / "ign_borea_A"
    rows = [line.split() for line in (folder / "eo_lambert93_ign69.OPK").read_text().splitlines()[1:] if line]
    photo = {row[0]: i for i, row in enumerate(rows)}
    numbers = np.array([[float(v) for v in row[1:7]] for row in rows])
    longitude, latitude = Transformer.from_crs(2154, 4326, always_xy=True).transform(*numbers[:, :2].T)
    centres = numbers[:, :3].copy()
    centres[:, 2] += _geoid(folder / "fr_ign_RAF20.tif", longitude, latitude)
    rotations = rotation_from_opk(np.radians(numbers[:, 3:]))

    names, pixels = _observations(folder / "tie_points.mes")
    control_names, control_pixels = _observations(folder / "gcp_image.mes")
    names, pixels = names + control_names, np.concatenate([pixels, control_pixels])
    points = {name: i for i, name in enumerate(dict.fromkeys(name for name, _ in names))}
    image = (pixels - PRINCIPAL_PX) * [1, -1] / FOCAL_PX
    of_photo = np.array([photo[name] for _, name in names])
    index = np.array([points[name] for name, _ in names])
    sigma = np.full(len(index), 0.2 / FOCAL_PX)
    found = intersect_rays(Rays(index, centres[of_photo], rotations[of_photo], image, sigma))
    # 56 points were measured in one photograph only.
    np.testing.assert_array_equal(found.converged, found.redundancy > 0)
    assert np.sum(found.redundancy < 0) == 56

    text = (folder / "tie_points_world_ellipsoidal.mes").read_text()
    published = [line.split() for line in text.splitlines() if line]
    assert len(published) == 1782 - 56
    ours = found.points[[points[row[0]] for row in published]]
    difference = ours - np.array([[float(v) for v in row[1:4]] for row in published])
    np.testing.assert_allclose(difference.mean(axis=0), [0.0, 0.0, -0.009], atol=0.0055)
    assert difference[:, 2].std() == pytest.approx(0.022, abs=0.002)
    # The published figures are those of points in three photographs or more.
    ties = np.array([name != "1003" for name, _ in names]) & (found.redundancy[index] >= 3)
    rms = np.sqrt(np.mean((found.residuals[ties] * FOCAL_PX) ** 2, axis=0))
    np.testing.assert_allclose(rms, [0.145, 0.192], atol=0.0006)
    control = [float(v) for v in (folder / "gcp_ellipsoidal.app").read_text().replace('"', "").split()[-3:]]
    np.testing.assert_allclose(found.points[points["1003"]] - control, [0.01, -0.02, 0.0], atol=0.0055)
    # The stated covariances are those of such a block: some centimetres in plan, twice that in height.
    heights = np.sqrt(found.covariances[:, 2, 2])
    assert 0.02 < np.nanmedian(heights) < 0.15
