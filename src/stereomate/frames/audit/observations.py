"""What an audit is computed from: an orientation as written, image observations, points with known ground."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError
from stereomate.frames.attitude import AttitudeConvention
from stereomate.frames.tangent import TangentFrame

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class WrittenBlock:
    """An orientation as a file writes it, with what it is declared to mean.

    Attributes
    ----------
    crs : str
        Of positions and of the reference points.
    positions : ndarray (p, 3)
        In the map, heights as written.
    attitudes : ndarray (p, 3) or (p, 3, 3)
    convention : AttitudeConvention
        As declared, or the first guess.
    origin : TangentFrame or None
        Of attitudes about tangent axes.
    """

    crs: str
    positions: Array
    attitudes: Array
    convention: AttitudeConvention
    origin: TangentFrame | None = None


@dataclass(frozen=True, eq=False)
class AuditObservations:
    """Image observations of points, some of which have known ground coordinates.

    Attributes
    ----------
    point_of, photo_of : ndarray of int (m,)
        Point and photograph of each observation.
    image : ndarray (m, 2)
        Ideal image coordinates in units of the principal distance.
    c_px : ndarray (m,)
        Principal distance in pixels, so that residuals can be told in pixels.
    names : tuple of str (n,)
        Of the points.
    reference : ndarray (n, 3)
        Known map coordinates with heights as written; NaN where there are none.
    control : ndarray of bool (n,)
        Control points; the other known coordinates come from an earlier evaluation.
    """

    point_of: Indices
    photo_of: Indices
    image: Array
    c_px: Array
    names: tuple[str, ...]
    reference: Array
    control: NDArray[np.bool_]

    def __post_init__(self) -> None:
        m, n = len(self.point_of), len(self.names)
        shapes = {"photo_of": (m,), "image": (m, 2), "c_px": (m,), "reference": (n, 3), "control": (n,)}
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise InputError(f"must have shape {shape}", field=name, value=np.shape(getattr(self, name)))

    @property
    def rays(self) -> Indices:
        """Number of rays of each point."""
        return np.bincount(self.point_of, minlength=len(self.names)).astype(np.int64)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Points with ground coordinates (n,)."""
        return np.asarray(np.isfinite(self.reference).all(axis=1))

    def of_points(self, keep: NDArray[np.bool_]) -> AuditObservations:
        """The observations of some points only."""
        number = np.cumsum(keep) - 1
        rows = keep[self.point_of]
        return replace(
            self,
            point_of=number[self.point_of[rows]].astype(np.int64),
            photo_of=self.photo_of[rows],
            image=self.image[rows],
            c_px=self.c_px[rows],
            names=tuple(name for name, kept in zip(self.names, keep, strict=True) if kept),
            reference=self.reference[keep],
            control=self.control[keep],
        )

    def usable(self) -> AuditObservations:
        """Points of three rays and more, which check themselves in both directions; of two where there are
        none."""
        keep = self.rays >= 3
        if keep.sum() < 6:
            keep = self.rays >= 2
        if not keep.any():
            raise InputError("no point is seen in two photographs", field="observations")
        return self.of_points(np.asarray(keep | (self.control & (self.rays >= 2))))

    def sample(self, count: int) -> AuditObservations:
        """At most `count` points, spread over the list; control is kept."""
        n = len(self.names)
        if n <= count:
            return self
        keep = self.control.copy()
        keep[np.linspace(0, n - 1, count).astype(np.int64)] = True
        return self.of_points(keep)
