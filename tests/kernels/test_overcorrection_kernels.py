"""Kernels of the over-correction factor, also run with bounds checks."""

from __future__ import annotations

import numpy as np

from stereomate.relative.kernels import overcorrection as kernels


def test_factors_of_all_rows():
    section = np.array([[[0.0, 1500.0], [-500.0, 1500.0], [500.0, 1500.0]]] * 4)
    for row, expected in enumerate((-9.0, 5.0, 5.0)):
        factors = np.empty(4)
        assert kernels.overcorrection_factors(section, row, factors) == -1
        np.testing.assert_allclose(factors, expected)


def test_first_invalid_section_is_returned():
    sections = np.ones((5, 3, 2))
    sections[3, 2, 1] = 0.0
    assert kernels.overcorrection_factors(sections, 2, np.empty(5)) == 3
    terms = np.empty((3, 5))
    assert kernels.all_section_terms(sections, terms, terms.copy(), terms.copy(), np.empty(5)) == 3


def test_terms_of_no_section():
    empty = np.empty((3, 0))
    assert kernels.all_section_terms(np.empty((0, 3, 2)), empty, empty, empty, np.empty(0)) == -1
