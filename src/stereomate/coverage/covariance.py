"""How well the photographs of a survey are oriented, and how far two of them err together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError
from stereomate.frames.tangent import TangentFrame

Array = NDArray[np.float64]
Record = dict[str, Any]

# Heights come from differences of orientations that err together, which takes some digits off.
_DIGITS: Final = 10
# Correlations beyond one by more than rounding are no covariance.
_NEGATIVE: Final = -1e-6


@dataclass(frozen=True, eq=False)
class OrientationCovariance:
    """Covariances of adjusted orientations.

    Six unknowns of a photograph: its centre (X, Y, Z, metres), then a small rotation theta (radians) with
    true rotation = exp(theta) times the one in use; all along and about the axes of one tangent frame.

    Attributes
    ----------
    photographs : mapping of str to ndarray (6, 6)
        By name.
    pairs : mapping of (str, str) to ndarray (6, 6)
        First by second; a pair stands here in one order.
    """

    photographs: Mapping[str, Array]
    pairs: Mapping[tuple[str, str], Array]

    def of_pair(self, left: str, right: str) -> Array:
        """Covariance (12, 12) of two orientations; NaN where it is not known how far they err together."""
        nothing = np.full((6, 6), np.nan)
        common = self.pairs.get((left, right))
        if common is None:
            common = self.pairs.get((right, left), nothing).T
        own = [self.photographs.get(name, nothing) for name in (left, right)]
        return np.block([[own[0], common], [common.T, own[1]]])

    def among(self, names: Iterable[str], pairs: Iterable[tuple[str, str]]) -> OrientationCovariance:
        """What is known of some photographs and pairs."""
        wanted, ordered = set(names), list(pairs)
        both = {pair for left, right in ordered for pair in ((left, right), (right, left))}
        return OrientationCovariance(
            {name: value for name, value in self.photographs.items() if name in wanted},
            {pair: value for pair, value in self.pairs.items() if pair in both},
        )

    def renamed(self, names: Mapping[str, str]) -> OrientationCovariance:
        """The same of photographs that go by other names here; of those not among `names` nothing."""
        return OrientationCovariance(
            {names[name]: value for name, value in self.photographs.items() if name in names},
            {(names[a], names[b]): v for (a, b), v in self.pairs.items() if a in names and b in names},
        )

    def in_frame(self, target: TangentFrame, source: TangentFrame) -> OrientationCovariance:
        """The same along the axes of another tangent frame."""
        turn = target.rotation_geocentric_from_tangent.T @ source.rotation_geocentric_from_tangent
        six = np.kron(np.eye(2), turn)
        return OrientationCovariance(
            {name: six @ value @ six.T for name, value in self.photographs.items()},
            {pair: six @ value @ six.T for pair, value in self.pairs.items()},
        )

    def as_record(self) -> Record:
        """Plain values: upper triangles of photographs and whole blocks of pairs, row after row."""
        upper = np.triu_indices(6)
        return {
            "photographs": [[name, _digits(value[upper])] for name, value in self.photographs.items()],
            "pairs": [[*pair, _digits(value.ravel())] for pair, value in self.pairs.items()],
        }

    @classmethod
    def from_record(cls, record: Record) -> OrientationCovariance:
        """Inverse of `as_record`.

        Raises
        ------
        FormatError
            If the values of a photograph are no covariance matrix; the photograph is named.
        """
        upper = np.triu_indices(6)
        photographs = {}
        for name, values in record["photographs"]:
            matrix = np.zeros((6, 6))
            matrix[upper] = values
            matrix = matrix + np.triu(matrix, 1).T
            if not _is_covariance(matrix):
                raise FormatError("must be a covariance matrix", field=f"photographs: {name}")
            photographs[str(name)] = matrix
        pairs = {}
        for left, right, values in record["pairs"]:
            matrix = np.array(values, np.float64).reshape(6, 6)
            if not np.isfinite(matrix).all():
                raise FormatError("must be finite", field=f"pairs: {left}, {right}")
            pairs[str(left), str(right)] = matrix
        return cls(photographs, pairs)


def _is_covariance(matrix: Array) -> bool:
    sigma = np.sqrt(np.maximum(np.diagonal(matrix), 0.0))
    if not (np.isfinite(matrix).all() and (sigma > 0.0).all()):
        return False
    return bool(np.linalg.eigvalsh(matrix / np.outer(sigma, sigma)).min() > _NEGATIVE)


def _digits(values: Array) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in values.tolist()]
