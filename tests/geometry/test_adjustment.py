"""The refinement loop: damping, convergence, what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from stereomate.errors import InputError, NotDeterminedError
from stereomate.geometry.adjustment import AdjustmentOptions, adjust


def _decay(state):
    """Observed exp(-0.7 t) * 3, computed a exp(-b t)."""
    t = np.linspace(0, 4, 9)
    a, b = state
    computed = a * np.exp(-b * t)
    design = np.stack([np.exp(-b * t), -a * t * np.exp(-b * t)], axis=-1)
    return 3.0 * np.exp(-0.7 * t) - computed, design


def test_a_poor_start_is_damped_to_the_solution():
    state, summary = adjust(_decay, lambda s, step: s + step, np.array([20.0, 3.5]), np.ones(9))
    np.testing.assert_allclose(state, [3.0, 0.7], atol=1e-9)
    assert summary.converged
    assert summary.redundancy == 7


def test_a_loop_cut_short_says_so():
    options = AdjustmentOptions(max_iterations=2)
    _, summary = adjust(_decay, lambda s, step: s + step, np.array([20.0, 3.5]), np.ones(9), options)
    assert not summary.converged
    assert summary.iterations == 2


def test_statistics_of_a_weighted_mean():
    observed, sigma = np.array([10.0, 10.4, 9.7]), np.array([0.1, 0.2, 0.3])
    state, summary = adjust(
        lambda s: (observed - s, np.ones((3, 1))), lambda s, step: s + step, np.zeros(1), sigma
    )
    weights = 1 / sigma**2
    mean = weights @ observed / weights.sum()
    assert state[0] == pytest.approx(mean)
    assert summary.cofactor[0, 0] == pytest.approx(1 / weights.sum())
    assert summary.sigma0**2 == pytest.approx(weights @ (observed - mean) ** 2 / 2)
    np.testing.assert_allclose(summary.redundancy_numbers, 1 - weights / weights.sum())
    deviation = summary.sigma0 * sigma * np.sqrt(summary.redundancy_numbers)
    np.testing.assert_allclose(summary.standardized_residuals, (observed - mean) / deviation)


def test_undetermined_unknowns_are_an_error():
    def flat(s):
        return np.zeros(3), np.array([[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]])

    with pytest.raises(NotDeterminedError, match="combination"):
        adjust(flat, lambda s, step: s + step, np.zeros(2), np.ones(3))
    with pytest.raises(NotDeterminedError, match="no influence"):
        adjust(
            lambda s: (np.zeros(3), np.array([[1.0, 0.0]] * 3)), lambda s, step: s, np.zeros(2), np.ones(3)
        )
    with pytest.raises(NotDeterminedError, match="1 observations"):
        adjust(lambda s: (np.zeros(1), np.ones((1, 2))), lambda s, step: s, np.zeros(2), np.ones(1))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"max_iterations": 0}, "max_iterations"),
        ({"loss": "l1"}, "loss"),
        ({"huber_width": 0.0}, "huber_width"),
    ],
)
def test_wrong_options_are_refused(change, field):
    with pytest.raises(InputError, match=field):
        AdjustmentOptions(**change)
