"""Ebner's twelve in simulated blocks: empirical errors against what is stated of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from blocks import make_block
from scipy.stats import chi2

from stereomate.block.adjustment import adjust_block
from stereomate.block.network import BlockCamera
from stereomate.block.options import BlockOptions
from stereomate.camera.distortion import BrownDistortion, EbnerDeformation
from stereomate.camera.model import EBNER_NAMES, Camera

LENS = BrownDistortion.from_certificate((0.0, 2e-6, -1e-9), (1e-6, -2e-6), (0.01, -0.02))
TWELVE = (0.02, -0.012, 0.015, -0.01, 0.02, -0.015, 0.012, 0.01, -0.02, 0.01, -0.01, 0.015)
FILM = replace(
    Camera.from_pixel_pitch("film", (6000, 4000), 24.0, 0.004, (0.01, -0.02), LENS),
    deformation=EbnerDeformation(8.0, *TWELVE),
    projective_per_mm=(1e-5, -2e-5),
)
# Half of them nobody knows, the others by a prior that errs.
FREE = {name: math.inf if k % 2 else 0.01 for k, name in enumerate(EBNER_NAMES)}


def _adjusted(seed, keys=EBNER_NAMES):
    block = make_block(
        gnss=0.05, control=5, camera=FILM, free={}, noise_seed=seed, start=(0.2, 0.002), per_photo=30
    )
    values, names = np.array(FILM.parameters), FILM.parameter_names
    rng = np.random.default_rng([7, seed])
    for name in EBNER_NAMES:
        at = names.index(name)
        values[at] = values[at] + rng.normal(0.0, FREE[name]) if math.isfinite(FREE[name]) else 0.0
    start = FILM.with_parameters(values)
    free = {name: FREE[name] for name in keys}
    network = replace(block.network, cameras=(BlockCamera(start, free),))
    return block, adjust_block(network, BlockOptions(scale_by="prior", robust="none"))


def _compare(count):
    totals = {"ebner": np.zeros(2), "centres": np.zeros(2), "points": np.zeros(2), "sigma0": np.zeros(2)}
    for seed in range(count):
        block, result = _adjusted(seed)
        cofactors = result.statistics.cofactors
        error = result.shared - TWELVE
        totals["ebner"] += error @ np.linalg.solve(cofactors.shared, error), 12
        # Neighbours are correlated: one of each kind from every block.
        k, j = seed % len(block.centres), seed % len(block.points)
        error = result.centres[k] - block.centres[k]
        totals["centres"] += error @ np.linalg.solve(cofactors.photos[k, :3, :3], error), 3
        error = result.points[j] - block.points[j]
        totals["points"] += error @ np.linalg.solve(cofactors.points[j], error), 3
        totals["sigma0"] += result.test.statistic, result.redundancy
    return totals


@pytest.mark.slow
def test_errors_of_ebners_parameters_are_what_is_stated():
    for name, (total, degrees) in _compare(60).items():
        assert chi2.ppf(0.005, degrees) < total < chi2.ppf(0.995, degrees), name


def test_without_them_the_deformation_is_in_residuals_and_points():
    block, with_twelve = _adjusted(0)
    _, without = _adjusted(0, keys=())
    assert with_twelve.test.passed
    assert not without.test.passed
    assert without.sigma0 > 3.0
    good, bad = (np.abs(result.points - block.points)[:, 2].mean() for result in (with_twelve, without))
    assert bad > 3.0 * good
