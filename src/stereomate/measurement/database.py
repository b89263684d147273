"""Measurements of a block in one SQLite file that COLMAP reads: features, matches, orientations of pairs.

Every finished photograph and every finished pair is one transaction: a run that is killed loses the item it
was working on and no other. What COLMAP has no place for stands in tables of our own (`stereomate_done`, the
key and record of finished work; `stereomate_tie_points`), which COLMAP passes over. COLMAP counts pixels as
this package does, the centre of the first at (0.5, 0.5); its cameras look along +z with y down.
"""

from __future__ import annotations

import json
import sqlite3
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import FormatError, InputError, StorageError
from stereomate.measurement import database_schema as schema
from stereomate.measurement.database_rows import (
    CameraRow,
    ImageRow,
    PairRow,
    blob,
    pair_geometry,
    pair_pose,
)
from stereomate.measurement.database_work import forget, set_done
from stereomate.measurement.features import Features
from stereomate.measurement.matching import Matches
from stereomate.measurement.tracks import TiePoints

Array = NDArray[np.float64]

# COLMAP's quantisation of square roots of SIFT's sums.
_DESCRIPTOR_UNIT: Final = 512.0


class MeasurementDatabase:
    """An open database; safe to use from any number of threads. Use `open`, and as a context manager."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection
        self._lock = threading.RLock()

    @classmethod
    def open(cls, path: Path, read_only: bool = False) -> Self:
        """Open a database, or make an empty one.

        Raises
        ------
        FormatError
            If the file is no such database.
        StorageError
            If it cannot be opened or made.
        """
        if read_only and not path.is_file():
            raise FormatError("does not exist", file=path)
        mode = "ro" if read_only else "rwc"
        try:
            connection = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode={mode}", uri=True, check_same_thread=False, timeout=30.0
            )
        except sqlite3.Error as error:
            raise StorageError(f"{path}: cannot be opened ({error})") from error
        try:
            if read_only:
                if not schema.has_table(connection, "images"):
                    raise FormatError("must have the table images of COLMAP", file=path)
            else:
                schema.create_tables(connection)
        except sqlite3.DatabaseError as error:
            connection.close()
            if isinstance(error, sqlite3.OperationalError):
                raise StorageError(f"{path}: cannot be written ({error})") from error
            raise FormatError("must be an SQLite database", file=path, value=str(error)) from error
        except FormatError:
            connection.close()
            raise
        return cls(path, connection)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """One transaction: whole or not at all."""
        with self._lock:
            try:
                with self._connection:
                    yield self._connection
            except sqlite3.OperationalError as error:
                raise StorageError(f"{self.path}: cannot be written ({error})") from error

    def _read(self, query: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        with self._lock:
            try:
                return self._connection.execute(query, values).fetchall()
            except sqlite3.DatabaseError as error:
                raise FormatError("cannot be read", file=self.path, value=str(error)) from error

    # ---- photographs and cameras

    def set_photographs(self, cameras: Mapping[int, CameraRow], images: Sequence[ImageRow]) -> None:
        """State all cameras and photographs; what belonged to photographs that went is removed.

        Photographs are numbered from 1; the same names must have the same numbers as before, or all they
        have is removed.
        """
        before = {row.image_id: row for row in self.images()}
        wanted = {row.image_id: row for row in images}
        changed = [k for k, row in before.items() if wanted.get(k, ImageRow(k, "", 0)).name != row.name]
        with self._writing() as connection:
            for number in changed:
                forget(connection, number)
            for table in ("frame_data", "frames", "rigs", "cameras"):
                connection.execute(f"DELETE FROM {table}")
            connection.executemany(
                "INSERT INTO cameras VALUES (?, ?, ?, ?, ?, 1)",
                [(k, c.model, *c.size_px, blob(c.parameters, np.float64)) for k, c in cameras.items()],
            )
            connection.executemany(
                "INSERT INTO rigs VALUES (?, ?, ?)", [(k, k, schema.SENSOR_CAMERA) for k in cameras]
            )
            connection.executemany(
                "INSERT OR REPLACE INTO images (image_id, name, camera_id) VALUES (?, ?, ?)",
                [(row.image_id, row.name, row.camera_id) for row in images],
            )
            connection.executemany(
                "INSERT INTO frames VALUES (?, ?)", [(row.image_id, row.camera_id) for row in images]
            )
            connection.executemany(
                "INSERT INTO frame_data VALUES (?, ?, ?, ?)",
                [(row.image_id, row.image_id, row.camera_id, schema.SENSOR_CAMERA) for row in images],
            )

    def images(self) -> tuple[ImageRow, ...]:
        """All photographs by number."""
        rows = self._read("SELECT image_id, name, camera_id FROM images ORDER BY image_id")
        return tuple(ImageRow(int(a), str(b), int(c)) for a, b, c in rows)

    def cameras(self) -> dict[int, CameraRow]:
        """All cameras by number."""
        rows = self._read("SELECT camera_id, model, width, height, params FROM cameras ORDER BY camera_id")
        return {
            int(k): CameraRow(int(m), (int(w), int(h)), tuple(np.frombuffer(p, np.float64).tolist()))
            for k, m, w, h, p in rows
        }

    def set_positions(self, positions: Mapping[int, tuple[float, float, float]]) -> None:
        """Latitude, longitude (degrees) and altitude of photographs, as priors for COLMAP."""
        cameras = {row.image_id: row.camera_id for row in self.images()}
        with self._writing() as connection:
            connection.execute("DELETE FROM pose_priors")
            connection.executemany(
                "INSERT INTO pose_priors VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                [
                    (
                        k,
                        k,
                        cameras[k],
                        schema.SENSOR_CAMERA,
                        blob(value, np.float64),
                        blob([np.nan] * 9, np.float64),
                        blob([np.nan] * 3, np.float64),
                        schema.WGS84,
                    )
                    for k, value in positions.items()
                ],
            )

    # ---- finished work

    def done(self, kind: str) -> dict[str, tuple[str, dict[str, Any]]]:
        """Finished items of a kind: name -> (key, record)."""
        if not schema.has_table(self._connection, "stereomate_done"):
            return {}
        rows = self._read("SELECT name, key, record FROM stereomate_done WHERE kind = ?", (kind,))
        return {str(name): (str(key), json.loads(record)) for name, key, record in rows}

    def set_done(self, kind: str, name: str, key: str, record: Mapping[str, Any]) -> None:
        """State that an item is finished."""
        with self._writing() as connection:
            set_done(connection, kind, name, key, record)

    # ---- features

    def put_features(self, image_id: int, features: Features, key: str, record: Mapping[str, Any]) -> None:
        """Keep the features of a photograph, and that they are finished; pairs it had are removed."""
        points = np.column_stack([features.pixels, features.size_px / 2.0, features.angle])
        descriptors = np.clip(np.rint(features.descriptors * _DESCRIPTOR_UNIT), 0, 255)
        with self._writing() as connection:
            forget(connection, image_id, keep_image=True)
            connection.execute(
                "INSERT INTO keypoints VALUES (?, ?, 4, ?)",
                (image_id, len(points), blob(points, np.float32)),
            )
            connection.execute(
                "INSERT INTO descriptors (image_id, type, rows, cols, data) VALUES (?, ?, ?, 128, ?)",
                (image_id, schema.SIFT, len(points), blob(descriptors, np.uint8)),
            )
            set_done(connection, "features", str(image_id), key, record)

    def features(self, image_id: int) -> Features:
        """Features of a photograph as they are kept: positions to single precision, descriptors to bytes.

        Raises
        ------
        InputError
            If there are none.
        """
        pixels, size, angle = self.keypoints(image_id)
        found = self._read("SELECT rows, cols, data FROM descriptors WHERE image_id = ?", (image_id,))
        if not found:
            raise InputError(
                "has no descriptors in the database", file=self.path, field="image", value=image_id
            )
        rows, cols, data = found[0]
        descriptors = np.frombuffer(data, np.uint8).reshape(rows, cols).astype(np.float32)
        descriptors /= np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-12)
        # The strength is not kept: the order tells which is stronger.
        response = np.arange(rows, 0, -1, dtype=np.float64)
        return Features(pixels, size, angle, response, descriptors)

    def keypoints(self, image_id: int) -> tuple[Array, Array, Array]:
        """Pixels (n, 2), diameters and directions (n,) of the features of a photograph."""
        found = self._read("SELECT rows, cols, data FROM keypoints WHERE image_id = ?", (image_id,))
        if not found:
            raise InputError(
                "has no keypoints in the database", file=self.path, field="image", value=image_id
            )
        rows, cols, data = found[0]
        values = np.frombuffer(data, np.float32).reshape(rows, cols).astype(np.float64)
        if cols == 2:
            return values, np.ones(rows), np.zeros(rows)
        if cols == 4:
            return values[:, :2].copy(), 2.0 * values[:, 2], values[:, 3].copy()
        # Affine shapes a11 a12 a21 a22: the scale is the mean of both axes, the direction that of the first.
        a = values[:, 2:6]
        scale = (np.hypot(a[:, 0], a[:, 2]) + np.hypot(a[:, 1], a[:, 3])) / 2.0
        return values[:, :2].copy(), 2.0 * scale, np.arctan2(a[:, 2], a[:, 0])

    # ---- pairs

    def put_pair(self, pair: PairRow, matches: Matches, key: str, record: Mapping[str, Any]) -> None:
        """Keep matches and orientation of a pair, and that it is finished."""
        if pair.first > pair.second:
            raise InputError(
                "must have the lower number first", field="pair", value=(pair.first, pair.second)
            )
        number = schema.pair_number(pair.first, pair.second)
        raw = np.column_stack([matches.left, matches.right])
        geometry: tuple[bytes | None, ...] = (None,) * 4
        if pair.base is not None and pair.first_from_second is not None:
            geometry = pair_geometry(pair.base, pair.first_from_second)
        config = schema.DEGENERATE if pair.base is None else schema.CALIBRATED
        with self._writing() as connection:
            for table in ("matches", "two_view_geometries"):
                connection.execute(f"DELETE FROM {table} WHERE pair_id = ?", (number,))
            connection.execute(
                "INSERT INTO matches VALUES (?, ?, 2, ?)", (number, len(raw), blob(raw, np.uint32))
            )
            essential, identity, quaternion, shift = geometry
            columns = schema.columns_of(connection, "two_view_geometries")
            values = {
                "pair_id": number,
                "rows": len(pair.rows),
                "cols": 2,
                "data": blob(pair.rows, np.uint32),
                "config": config,
                "F": identity,
                "E": essential,
                "H": identity,
                "qvec": quaternion,
                "tvec": shift,
            }
            names = [name for name in columns if name in values]
            listed, marks = ", ".join(names), ", ".join("?" * len(names))
            connection.execute(
                f"INSERT INTO two_view_geometries ({listed}) VALUES ({marks})",
                [values[name] for name in names],
            )
            set_done(connection, "pair", f"{pair.first}-{pair.second}", key, record)

    def pairs(self) -> tuple[PairRow, ...]:
        """All pairs with points that agree, in the order of their numbers."""
        columns = schema.columns_of(self._connection, "two_view_geometries")
        pose = "qvec, tvec" if "qvec" in columns else "NULL, NULL"
        rows = self._read(
            f"SELECT pair_id, rows, cols, data, config, {pose} FROM two_view_geometries ORDER BY pair_id"
        )
        pairs = []
        for number, count, cols, data, config, quaternion, shift in rows:
            first, second = schema.images_of_pair(int(number))
            found = np.frombuffer(data or b"", np.uint32).reshape(count, cols).astype(np.int64)
            base = turn = None
            if config == schema.CALIBRATED and quaternion and shift:
                base, turn = pair_pose(quaternion, shift)
            pairs.append(PairRow(first, second, found, base, turn))
        return tuple(pairs)

    # ---- tie points

    def put_tie_points(self, points: TiePoints, key: str, record: Mapping[str, Any]) -> None:
        """Keep the tie points of the block; photographs are those of the database in their order."""
        numbers = {row.name: row.image_id for row in self.images()}
        images = [numbers[name] for name in points.photographs]
        rows = zip(
            points.point.tolist(),
            [images[k] for k in points.photo.tolist()],
            points.feature.tolist(),
            points.pixels[:, 0].tolist(),
            points.pixels[:, 1].tolist(),
            points.sigma_px.tolist(),
            strict=True,
        )
        with self._writing() as connection:
            connection.execute("DELETE FROM stereomate_tie_points")
            connection.executemany("INSERT INTO stereomate_tie_points VALUES (?, ?, ?, ?, ?, ?)", rows)
            set_done(connection, "tie points", "", key, record)

    def tie_points(self) -> TiePoints:
        """The tie points of the block as they were kept."""
        images = self.images()
        place = {row.image_id: k for k, row in enumerate(images)}
        rows = self._read(
            "SELECT point, image_id, keypoint, col, row, sigma_px FROM stereomate_tie_points "
            "ORDER BY point, image_id"
        )
        values = np.array(rows, dtype=np.float64).reshape(-1, 6)
        return TiePoints(
            tuple(row.name for row in images),
            values[:, 0].astype(np.int64),
            np.array([place[int(k)] for k in values[:, 1]], dtype=np.int64),
            values[:, 3:5].copy(),
            values[:, 5].copy(),
            values[:, 2].astype(np.int64),
        )


__all__ = ["CameraRow", "ImageRow", "MeasurementDatabase", "PairRow"]
