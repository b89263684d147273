"""Rows of a measurement database as values, and how COLMAP writes the orientation of a pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stereomate.geometry.rotations import quaternion_from_rotation, rotation_from_quaternion

Array = NDArray[np.float64]

# y down, z forward.
_FLIP: Final = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class CameraRow:
    """A camera as COLMAP writes it: number of the model, size, parameters in pixels."""

    model: int
    size_px: tuple[int, int]
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class ImageRow:
    """A photograph: its number, name and the number of its camera."""

    image_id: int
    name: str
    camera_id: int


@dataclass(frozen=True)
class PairRow:
    """Points of two photographs that agree with an orientation, as rows of their features.

    Attributes
    ----------
    first, second : int
        Numbers of the photographs, in the order of `rows`.
    rows : ndarray of int, shape (m, 2)
    base, first_from_second : ndarray or None
        Relative orientation in the first camera's frame (x right, y up); None where there is none.
    """

    first: int
    second: int
    rows: NDArray[np.int64]
    base: Array | None = None
    first_from_second: Array | None = None


def blob(values: Any, kind: type[np.generic]) -> bytes:
    return np.ascontiguousarray(values, dtype=kind).tobytes()


def pair_geometry(base: Array, first_from_second: Array) -> tuple[bytes, bytes, bytes, bytes]:
    """E, an identity, quaternion (w, x, y, z) and shift of COLMAP's second camera from the first."""
    second_from_first = _FLIP @ first_from_second.T @ _FLIP
    shift = -second_from_first @ (_FLIP @ base)
    x, y, z = shift
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ second_from_first
    return (
        blob(essential, np.float64),
        blob(np.eye(3), np.float64),
        blob(quaternion_from_rotation(second_from_first), np.float64),
        blob(shift, np.float64),
    )


def pair_pose(quaternion: bytes, shift: bytes) -> tuple[Array | None, Array | None]:
    """Base and rotation of this package from COLMAP's; None for the identity that stands for nothing."""
    t = np.frombuffer(shift, np.float64)
    length = float(np.linalg.norm(t))
    if not length > 0.0:
        return None, None
    turn = rotation_from_quaternion(np.frombuffer(quaternion, np.float64))
    return _FLIP @ (-turn.T @ t / length), _FLIP @ turn.T @ _FLIP
