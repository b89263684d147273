"""The camera as a value: from the camera frame to pixels and back.

Camera frame: x right, y up, the camera looks along -z. Photo system: millimetres, x right, y up, image plane
at z = -c. Pixels: (column, row), (0, 0) the outer corner of the first pixel, centres at +0.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereomate.camera import kernels
from stereomate.camera.distortion import (
    BrownDistortion,
    Distortion,
    EbnerDeformation,
    FisheyeDistortion,
    NoDistortion,
    OpenCVDistortion,
)
from stereomate.camera.kernels.layout import R2_MAX
from stereomate.camera.packing import Affine2, FilmStage, interior_vector, model_code, pack, pack_jacobian
from stereomate.camera.pixel_array import check_size, pixel_from_photo_of_array
from stereomate.errors import InputError

Array = NDArray[np.float64]

# Ebner's twelve among the interior parameters: Brown's affinity is called b1 and b2 too.
EBNER_NAMES = tuple(f"ebner_{name}" for name in EbnerDeformation.coefficient_names)

__all__ = ["EBNER_NAMES", "Affine2", "Camera", "pixel_from_photo_of_array"]


@dataclass(frozen=True)
class Camera:
    """Interior orientation of a camera, as stored pixels see it.

    Parameters
    ----------
    name : str
        Name, unique in a project.
    size_px : (int, int)
        Columns and rows of the pixel array as stored.
    principal_distance_mm : float
        Principal distance c (calibrated focal length), positive.
    principal_point_mm : (float, float)
        Principal point of autocollimation in the photo system: the origin of the collinearity equations.
    pixel_from_photo : 2x3 nested tuples
        ``(column, row) = A (x_mm, y_mm, 1)``: pixel pitch, centre of the array or fiducial transform, turns
        and mirroring of the stored pixels.
    distortion : Distortion
        Lens distortion about its own point of best symmetry.
    format_mm : (float, float) or None
        Of film: width and height of the picture about the origin of the photo system. Beyond lie the frame
        and its marks: pixels of the array that show no ground.
    projective_per_mm : (float, float)
        Of a scan with a projective interior orientation: ``(column, row) = A (x, y, 1) / (1 + q1 x + q2 y)``.
    deformation : EbnerDeformation or None
        Of film: how the photo coordinates differ from those that the lens made.

    Raises
    ------
    InputError
        Naming the field that breaks a rule.
    """

    name: str
    size_px: tuple[int, int]
    principal_distance_mm: float
    principal_point_mm: tuple[float, float]
    pixel_from_photo: Affine2
    distortion: Distortion = field(default_factory=NoDistortion)
    format_mm: tuple[float, float] | None = None
    projective_per_mm: tuple[float, float] = (0.0, 0.0)
    deformation: EbnerDeformation | None = None

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("must not be empty", field="camera.name", value=self.name)
        where = f"camera {self.name!r}: "
        check_size(self.size_px, where)
        c = self.principal_distance_mm
        if not (math.isfinite(c) and c > 0.0):
            raise InputError("must be positive millimetres", field=where + "principal_distance_mm", value=c)
        point = self.principal_point_mm
        if np.shape(point) != (2,) or not np.isfinite(point).all():
            raise InputError("must be two finite numbers", field=where + "principal_point_mm", value=point)
        matrix = np.asarray(self.pixel_from_photo, dtype=np.float64)
        if matrix.shape != (2, 3) or not np.isfinite(matrix).all():
            raise InputError(
                "must be two rows of three finite numbers",
                field=where + "pixel_from_photo",
                value=self.pixel_from_photo,
            )
        if not abs(np.linalg.det(matrix[:, :2])) > 1e-12 * np.abs(matrix[:, :2]).max() ** 2:
            raise InputError(
                "must be invertible", field=where + "pixel_from_photo", value=self.pixel_from_photo
            )
        size = self.format_mm
        if size is not None and not (np.shape(size) == (2,) and np.isfinite(size).all() and min(size) > 0.0):
            raise InputError("must be positive width and height", field=where + "format_mm", value=size)
        q = self.projective_per_mm
        if np.shape(q) != (2,) or not np.isfinite(q).all():
            raise InputError("must be two finite numbers", field=where + "projective_per_mm", value=q)
        if self._is_film and isinstance(self.distortion, OpenCVDistortion | FisheyeDistortion):
            raise InputError(
                "must be Brown's or none where film is deformed or its scan projective",
                field=where + "distortion",
                value=type(self.distortion).__name__,
            )

    @classmethod
    def from_pixel_pitch(
        cls,
        name: str,
        size_px: tuple[int, int],
        principal_distance_mm: float,
        pixel_pitch_mm: float | tuple[float, float],
        principal_point_mm: tuple[float, float] = (0.0, 0.0),
        distortion: Distortion | None = None,
        rotation: int = 0,
        mirrored: bool = False,
    ) -> Camera:
        """Digital camera whose photo system has its origin at the centre of the pixel array.

        Parameters
        ----------
        size_px : (int, int)
            Columns and rows as stored (after turning).
        pixel_pitch_mm : float or (float, float)
            Pitch along the stored columns and rows.
        principal_point_mm : (float, float)
            In the photo system of the calibration: x right, y up, from the centre.
        rotation : {0, 90, 180, 270}
            Degrees by which the stored array is turned clockwise against the calibration.
        mirrored : bool
            The stored array is mirrored left to right (before it is turned).
        """
        check_size(size_px, f"camera {name!r}: ")
        pitch = pixel_pitch_mm if isinstance(pixel_pitch_mm, tuple) else (pixel_pitch_mm, pixel_pitch_mm)
        if not all(math.isfinite(v) and v > 0.0 for v in pitch):
            raise InputError(
                "must be positive millimetres", field=f"camera {name!r}: pixel_pitch_mm", value=pixel_pitch_mm
            )
        affine = pixel_from_photo_of_array(size_px, pitch, rotation, mirrored)
        return cls(
            name, size_px, principal_distance_mm, principal_point_mm, affine, distortion or NoDistortion()
        )

    @classmethod
    def from_focal_lengths(
        cls,
        name: str,
        size_px: tuple[int, int],
        focal_px: tuple[float, float],
        principal_point_px: tuple[float, float],
        distortion: Distortion | None = None,
        sensor_width_mm: float = 36.0,
    ) -> Camera:
        """Camera with focal lengths and principal point in pixels, as computer vision gives them.

        Parameters
        ----------
        focal_px : (float, float)
            fx and fy; their ratio becomes a ratio of pixel pitches.
        principal_point_px : (float, float)
            From the outer corner of the first pixel (add 0.5 to OpenCV's, which counts from its centre).
        sensor_width_mm : float
            Only gives the millimetres their size; 36 mm where nothing is known.
        """
        check_size(size_px, f"camera {name!r}: ")
        fx, fy = focal_px
        for value in (fx, fy, sensor_width_mm):
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(
                    "must be positive", field=f"camera {name!r}: focal_px or sensor_width_mm", value=value
                )
        columns, rows = size_px
        pitch = sensor_width_mm / columns
        c = fx * pitch
        pitch_y = c / fy
        point = ((principal_point_px[0] - columns / 2) * pitch, (rows / 2 - principal_point_px[1]) * pitch_y)
        return cls.from_pixel_pitch(name, size_px, c, (pitch, pitch_y), point, distortion)

    def kernel_parameters(self) -> tuple[int, Array]:
        """Model code and parameter array for the functions of `stereomate.camera.kernels`."""
        return pack(self.size_px, self.parameters, self.pixel_from_photo, self.distortion, self.film_stage)

    @property
    def _is_film(self) -> bool:
        return self.deformation is not None or self.projective_per_mm != (0.0, 0.0)

    @property
    def film_stage(self) -> FilmStage | None:
        """What film adds to the lens, for `stereomate.camera.packing`; None of an ordinary camera."""
        framed = self.format_mm is not None and isinstance(self.distortion, NoDistortion | BrownDistortion)
        if not (self._is_film or framed):
            return None
        spacing = 1.0 if self.deformation is None else self.deformation.spacing_mm
        width, height = self.format_mm or (math.inf, math.inf)
        return FilmStage(
            spacing, self.deformation is not None, self.projective_per_mm, (width / 2.0, height / 2.0)
        )

    def image_from_camera(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        """Pixels of points in the camera frame.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Camera frame, any length unit.

        Returns
        -------
        pixels : ndarray, shape (..., 2)
            Column and row; NaN behind the camera and beyond the monotonic range of the distortion.
        inside : ndarray of bool, shape (...)
            On the pixel array (0 <= column < columns), before the camera and within the monotonic range; not
            on the frame of film.
        """
        points = np.asarray(points, dtype=np.float64)
        shape = points.shape[:-1]
        flat = np.ascontiguousarray(points.reshape(-1, 3))
        pixels = np.empty((flat.shape[0], 2))
        inside = np.empty(flat.shape[0], dtype=np.bool_)
        model, parameters = self.kernel_parameters()
        kernels.image_from_camera_points(model, parameters, flat, pixels, inside)
        return pixels.reshape(*shape, 2), inside.reshape(shape)

    def rays_from_image(self, pixels: ArrayLike) -> Array:
        """Directions (x, y, -1) in the camera frame of pixel positions (..., 2).

        NaN beyond the monotonic range of the distortion. Positions off the pixel array are extrapolated.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        flat = np.ascontiguousarray(pixels.reshape(-1, 2))
        rays = np.empty((flat.shape[0], 3))
        model, parameters = self.kernel_parameters()
        kernels.rays_from_pixels(model, parameters, flat, rays)
        return rays.reshape(*pixels.shape[:-1], 3)

    def photo_from_image(self, pixels: ArrayLike) -> Array:
        """Measured photo coordinates in mm of pixel positions (..., 2): what lens and film did is in them."""
        matrix = np.array(self.pixel_from_photo)
        pixels = np.asarray(pixels, dtype=np.float64)
        if self.projective_per_mm != (0.0, 0.0):
            whole = np.linalg.inv(np.vstack([matrix, [*self.projective_per_mm, 1.0]]))
            top = pixels @ whole[:2, :2].T + whole[:2, 2]
            projected: Array = top / (pixels @ whole[2, :2] + whole[2, 2])[..., None]
            return projected
        inverse = np.linalg.inv(matrix[:, :2])
        result: Array = (pixels - matrix[:, 2]) @ inverse.T
        return result

    def image_from_photo(self, photo_mm: ArrayLike) -> Array:
        """Pixel positions of measured photo coordinates in mm (..., 2)."""
        matrix = np.array(self.pixel_from_photo)
        photo_mm = np.asarray(photo_mm, dtype=np.float64)
        result: Array = photo_mm @ matrix[:, :2].T + matrix[:, 2]
        if self.projective_per_mm != (0.0, 0.0):
            result = result / (1.0 + photo_mm @ np.array(self.projective_per_mm))[..., None]
        return result

    def in_picture(self, pixels: ArrayLike, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Whether pixel positions (..., 2) lie in the picture, not on the frame of the film around it.

        And by so many pixels within its edge.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        if self.format_mm is None:
            return np.ones(pixels.shape[:-1], np.bool_)
        (a, b, _), (d, e, _) = self.pixel_from_photo
        half = np.array(self.format_mm) / 2.0 - margin_px / math.sqrt(abs(a * e - b * d))
        return np.asarray((np.abs(self.photo_from_image(pixels)) <= half).all(axis=-1))

    def picture_px(self, shares: ArrayLike) -> Array:
        """Pixel positions of shares (..., 2) of the picture as stored: (0, 0) first corner, (1, 1) last.

        The picture is the pixel array; of film the part of it within the frame.
        """
        shares, size = np.asarray(shares, dtype=np.float64), np.array(self.size_px, dtype=np.float64)
        if self.format_mm is None:
            return np.asarray(shares * size)
        linear = np.array(self.pixel_from_photo)[:, :2]
        turned = abs(linear[0, 1]) > abs(linear[0, 0])
        steps = (shares[..., ::-1] if turned else shares) - 0.5  # along x and y of the photo system
        signs = np.sign(linear[[1, 0], [0, 1]] if turned else linear[[0, 1], [0, 1]])
        return np.asarray(np.clip(self.image_from_photo(steps * signs * np.array(self.format_mm)), 0.0, size))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the interior parameters, in the order of `parameters` and of the Jacobians."""
        symmetry: tuple[str, ...] = ()
        if isinstance(self.distortion, BrownDistortion) and self.distortion.symmetry_mm is not None:
            symmetry = ("symmetry_x_mm", "symmetry_y_mm")
        first = ("principal_distance_mm", "principal_point_x_mm", "principal_point_y_mm")
        twelve = () if self.deformation is None else EBNER_NAMES
        return (*first, *symmetry, *self.distortion.coefficient_names, *twelve)

    @property
    def parameters(self) -> tuple[float, ...]:
        """Values of the interior parameters, in the order of `parameter_names`."""
        return interior_vector(
            self.principal_distance_mm, self.principal_point_mm, self.distortion, self.deformation
        )

    def with_parameters(self, values: ArrayLike) -> Camera:
        """The same camera with other interior parameters, in the order of `parameter_names`."""
        numbers = [float(v) for v in np.asarray(values, dtype=np.float64)]
        names = self.parameter_names
        if len(numbers) != len(names):
            raise InputError(
                f"must be {len(names)} interior parameters", field=f"camera {self.name!r}", value=len(numbers)
            )
        deformation = self.deformation
        if deformation is not None:
            deformation = EbnerDeformation(deformation.spacing_mm, *numbers[-len(EBNER_NAMES) :])
            names, numbers = names[: -len(EBNER_NAMES)], numbers[: -len(EBNER_NAMES)]
        changes: dict[str, object] = dict(zip(names[3:], numbers[3:], strict=True))
        if "symmetry_x_mm" in changes:
            changes["symmetry_mm"] = (changes.pop("symmetry_x_mm"), changes.pop("symmetry_y_mm"))
        distortion = replace(self.distortion, **changes)  # type: ignore[arg-type]
        return replace(
            self,
            principal_distance_mm=numbers[0],
            principal_point_mm=(numbers[1], numbers[2]),
            distortion=distortion,
            deformation=deformation,
        )

    def image_jacobians(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_], Array, Array]:
        """Pixels of points in the camera frame with their derivatives.

        Parameters
        ----------
        points : array_like, shape (n, 3)

        Returns
        -------
        pixels : ndarray, shape (n, 2)
        inside : ndarray of bool, shape (n,)
        d_points : ndarray, shape (n, 2, 3)
            By the point in the camera frame.
        d_interior : ndarray, shape (n, 2, m)
            By the interior parameters, in the order of `parameter_names`.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        n = points.shape[0]
        _, parameters = self.kernel_parameters()
        jacobian = self.parameter_jacobian()
        active = np.flatnonzero(np.any(jacobian != 0.0, axis=1)).astype(np.int64)
        pixels, inside = np.empty((n, 2)), np.empty(n, dtype=np.bool_)
        d_points, d_interior = np.empty((n, 2, 3)), np.empty((n, 2, jacobian.shape[1]))
        kernels.image_jacobians(
            self.jacobian_model, parameters, points, active, jacobian, pixels, inside, d_points, d_interior
        )
        return pixels, inside, d_points, d_interior

    def parameter_jacobian(self) -> Array:
        """d (parameter array of the kernels) / d (`parameters`), shape (kernels.LENGTH, n)."""
        return pack_jacobian(self.parameters, self.pixel_from_photo, self.distortion, self.film_stage)

    @property
    def monotonic_radius(self) -> float:
        """Radius, in units of the principal distance, up to which the distortion is monotonic.

        Of the ideal point where the model distorts, of the measured point where it corrects; infinite
        where the model has no limit.
        """
        return math.sqrt(float(self.kernel_parameters()[1][R2_MAX]))

    def covers_whole_array(self) -> bool:
        """Whether every pixel of the border has a ray: the distortion is monotonic up to the corners."""
        columns, rows = self.size_px
        t = np.linspace(0.0, 1.0, 65)
        zero, one = np.zeros_like(t), np.ones_like(t)
        border = np.concatenate(
            [np.stack(edge, axis=-1) for edge in ((t, zero), (t, one), (zero, t), (one, t))]
        ) * [columns, rows]
        return bool(np.isfinite(self.rays_from_image(border)).all())

    @property
    def jacobian_model(self) -> int:
        """Model code under which every interior parameter has its derivative.

        That of `kernel_parameters`, except for OpenCV's model where terms that are zero are not computed.
        """
        if isinstance(self.distortion, OpenCVDistortion):
            return kernels.OPENCV
        return model_code(self.distortion, self.film_stage)
