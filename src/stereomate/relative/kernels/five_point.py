"""The five-point problem: all essential matrices through five pairs of rays.

After D. Nistér, "An efficient solution to the five-point relative pose problem", PAMI 26 (2004): the
essential matrices of five pairs form ``x X + y Y + z Z + W``; the cubic constraints on an essential matrix
are eliminated by Gauss-Jordan to three equations linear in (x, y, 1) with polynomials in z; their determinant
has degree ten and its real roots, isolated by a Sturm chain, are the solutions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereomate.jit import kernel
from stereomate.relative.kernels.polynomial import DEGREE, real_roots, value

Array = NDArray[np.float64]

MAX_SOLUTIONS = 10


@kernel
def _null_space(rows: Array, basis: Array) -> bool:
    """Four orthonormal vectors, shape (4, 9), perpendicular to the five `rows` (5, 9), by Householder."""
    a = rows.copy()
    taus = np.zeros(5)
    for k in range(5):
        norm = 0.0
        for i in range(k, 9):
            norm += a[k, i] * a[k, i]
        norm = np.sqrt(norm)
        if norm < 1e-14:
            return False
        alpha = -norm if a[k, k] > 0.0 else norm
        head = a[k, k] - alpha
        a[k, k] = head
        taus[k] = -1.0 / (alpha * head)
        for j in range(k + 1, 5):
            s = 0.0
            for i in range(k, 9):
                s += a[k, i] * a[j, i]
            s *= taus[k]
            for i in range(k, 9):
                a[j, i] -= s * a[k, i]
    for m in range(4):
        for i in range(9):
            basis[m, i] = 0.0
        basis[m, 5 + m] = 1.0
        for k in range(4, -1, -1):
            s = 0.0
            for i in range(k, 9):
                s += a[k, i] * basis[m, i]
            s *= taus[k]
            for i in range(k, 9):
                basis[m, i] -= s * a[k, i]
    return True


@kernel
def _add_product_11(a: Array, b: Array, sign: float, out: Array) -> None:
    """Add ``sign a b`` of two linear forms (x, y, z, 1) to a quadratic (xx xy xz x yy yz y zz z 1)."""
    out[0] += sign * a[0] * b[0]
    out[1] += sign * (a[0] * b[1] + a[1] * b[0])
    out[2] += sign * (a[0] * b[2] + a[2] * b[0])
    out[3] += sign * (a[0] * b[3] + a[3] * b[0])
    out[4] += sign * a[1] * b[1]
    out[5] += sign * (a[1] * b[2] + a[2] * b[1])
    out[6] += sign * (a[1] * b[3] + a[3] * b[1])
    out[7] += sign * a[2] * b[2]
    out[8] += sign * (a[2] * b[3] + a[3] * b[2])
    out[9] += sign * a[3] * b[3]


@kernel
def _add_product_21(q: Array, b: Array, out: Array) -> None:
    """Add quadratic times linear form to a cubic, monomials in the order of Nistér's table.

    xxx yyy xxy xyy xxz xx yyz yy xyz xy | xzz xz x yzz yz y zzz zz z 1
    """
    out[0] += q[0] * b[0]
    out[1] += q[4] * b[1]
    out[2] += q[0] * b[1] + q[1] * b[0]
    out[3] += q[1] * b[1] + q[4] * b[0]
    out[4] += q[0] * b[2] + q[2] * b[0]
    out[5] += q[0] * b[3] + q[3] * b[0]
    out[6] += q[4] * b[2] + q[5] * b[1]
    out[7] += q[4] * b[3] + q[6] * b[1]
    out[8] += q[1] * b[2] + q[2] * b[1] + q[5] * b[0]
    out[9] += q[1] * b[3] + q[3] * b[1] + q[6] * b[0]
    out[10] += q[2] * b[2] + q[7] * b[0]
    out[11] += q[2] * b[3] + q[3] * b[2] + q[8] * b[0]
    out[12] += q[3] * b[3] + q[9] * b[0]
    out[13] += q[5] * b[2] + q[7] * b[1]
    out[14] += q[5] * b[3] + q[6] * b[2] + q[8] * b[1]
    out[15] += q[6] * b[3] + q[9] * b[1]
    out[16] += q[7] * b[2]
    out[17] += q[7] * b[3] + q[8] * b[2]
    out[18] += q[8] * b[3] + q[9] * b[2]
    out[19] += q[9] * b[3]


@kernel
def _constraints(basis: Array, equations: Array) -> None:
    """Ten cubic constraints: ``(E E' - trace(E E')/2) E = 0`` and ``det E = 0``; shape (10, 20)."""
    forms = np.empty((3, 3, 4))
    for i in range(3):
        for j in range(3):
            for m in range(4):
                forms[i, j, m] = basis[m, 3 * i + j]
    products = np.zeros((3, 3, 10))
    for i in range(3):
        for j in range(i, 3):
            for k in range(3):
                _add_product_11(forms[i, k], forms[j, k], 1.0, products[i, j])
    for m in range(10):
        half_trace = 0.5 * (products[0, 0, m] + products[1, 1, m] + products[2, 2, m])
        for i in range(3):
            products[i, i, m] -= half_trace
        products[1, 0, m] = products[0, 1, m]
        products[2, 0, m] = products[0, 2, m]
        products[2, 1, m] = products[1, 2, m]
    equations[:] = 0.0
    for i in range(3):
        for j in range(3):
            for k in range(3):
                _add_product_21(products[i, k], forms[k, j], equations[3 * i + j])
    minor = np.empty(10)
    for j in range(3):
        minor[:] = 0.0
        k, m = (j + 1) % 3, (j + 2) % 3
        _add_product_11(forms[1, k], forms[2, m], 1.0, minor)
        _add_product_11(forms[1, m], forms[2, k], -1.0, minor)
        _add_product_21(minor, forms[0, j], equations[9])


@kernel
def _eliminate(equations: Array) -> bool:
    """Gauss-Jordan with row pivoting on the first ten columns; only rows 4..9 are reduced upwards."""
    for c in range(10):
        pivot = c
        for r in range(c + 1, 10):
            if abs(equations[r, c]) > abs(equations[pivot, c]):
                pivot = r
        if abs(equations[pivot, c]) < 1e-14:
            return False
        if pivot != c:
            for j in range(c, 20):
                swap = equations[c, j]
                equations[c, j] = equations[pivot, j]
                equations[pivot, j] = swap
        scale = 1.0 / equations[c, c]
        for j in range(c, 20):
            equations[c, j] *= scale
        for r in range(c + 1, 10):
            factor = equations[r, c]
            if factor != 0.0:
                for j in range(c + 1, 20):
                    equations[r, j] -= factor * equations[c, j]
    for c in range(9, 4, -1):
        for r in range(4, c):
            factor = equations[r, c]
            if factor != 0.0:
                for j in range(10, 20):
                    equations[r, j] -= factor * equations[c, j]
    return True


@kernel
def _hidden_rows(e: Array, rows: Array) -> None:
    """Three rows (x, y, 1) of polynomials in z, coefficients from low to high; shape (3, 3, 5)."""
    rows[:] = 0.0
    for i in range(3):
        a, b = e[4 + 2 * i], e[5 + 2 * i]
        for part in range(2):
            c = 10 + 3 * part
            rows[i, part, 0] = a[c + 2]
            rows[i, part, 1] = a[c + 1] - b[c + 2]
            rows[i, part, 2] = a[c] - b[c + 1]
            rows[i, part, 3] = -b[c]
        rows[i, 2, 0] = a[19]
        rows[i, 2, 1] = a[18] - b[19]
        rows[i, 2, 2] = a[17] - b[18]
        rows[i, 2, 3] = a[16] - b[17]
        rows[i, 2, 4] = -b[16]


@kernel
def _determinant(rows: Array, poly: Array) -> None:
    """Determinant of `rows`, degree ten, coefficients from low to high."""
    poly[:] = 0.0
    minor = np.empty(7)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        minor[:] = 0.0
        for m in range(4):
            for n in range(4):
                minor[m + n] += rows[j, 0, m] * rows[k, 1, n] - rows[j, 1, m] * rows[k, 0, n]
        for m in range(5):
            for n in range(7):
                poly[m + n] += rows[i, 2, m] * minor[n]


@kernel
def _back_substitute(rows: Array, z: float) -> tuple[float, float, bool]:
    """(x, y, found) of a root z: the null vector of the three rows there."""
    at = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            at[i, j] = value(rows[i, j], 4, z)
        size = np.sqrt(at[i, 0] ** 2 + at[i, 1] ** 2 + at[i, 2] ** 2) + 1e-300
        for j in range(3):
            at[i, j] /= size
    best, x, y, w = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        a, b = at[i], at[(i + 1) % 3]
        n0 = a[1] * b[2] - a[2] * b[1]
        n1 = a[2] * b[0] - a[0] * b[2]
        n2 = a[0] * b[1] - a[1] * b[0]
        size = n0 * n0 + n1 * n1 + n2 * n2
        if size > best:
            best, x, y, w = size, n0, n1, n2
    if best == 0.0 or abs(w) < 1e-12 * np.sqrt(best):
        return 0.0, 0.0, False
    return x / w, y / w, True


@kernel
def five_point(left: Array, right: Array, essentials: Array) -> int:
    """Essential matrices ``l' E r = 0`` of five pairs of rays (5, 3); their number.

    Each is scaled to ``trace(E E') = 2``, that of a unit base.
    """
    rows = np.empty((5, 9))
    for p in range(5):
        for i in range(3):
            for j in range(3):
                rows[p, 3 * i + j] = left[p, i] * right[p, j]
    basis = np.empty((4, 9))
    if not _null_space(rows, basis):
        return 0
    equations = np.empty((10, 20))
    _constraints(basis, equations)
    if not _eliminate(equations):
        return 0
    hidden = np.empty((3, 3, 5))
    _hidden_rows(equations, hidden)
    poly = np.empty(DEGREE + 1)
    _determinant(hidden, poly)
    roots = np.empty(MAX_SOLUTIONS)
    found = real_roots(poly, roots)
    count = 0
    for k in range(found):
        z = roots[k]
        x, y, solved = _back_substitute(hidden, z)
        if not solved:
            continue
        size = 0.0
        for i in range(9):
            essentials[count, i] = x * basis[0, i] + y * basis[1, i] + z * basis[2, i] + basis[3, i]
            size += essentials[count, i] ** 2
        if not np.isfinite(size) or size == 0.0:
            continue
        scale = np.sqrt(2.0 / size)
        for i in range(9):
            essentials[count, i] *= scale
        count += 1
    return count
