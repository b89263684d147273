"""Finished work in a measurement database: what is kept of it, and what goes with a photograph."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from typing import Any

from stereomate.measurement import database_schema as schema


def set_done(
    connection: sqlite3.Connection, kind: str, name: str, key: str, record: Mapping[str, Any]
) -> None:
    connection.execute(
        "INSERT OR REPLACE INTO stereomate_done VALUES (?, ?, ?, ?)",
        (kind, name, key, json.dumps(record, sort_keys=True)),
    )


def forget(connection: sqlite3.Connection, image_id: int, keep_image: bool = False) -> None:
    """Remove what hangs on a photograph: its features, pairs, tie points and what was finished."""
    pairs = [
        number
        for (number,) in connection.execute(
            "SELECT pair_id FROM matches UNION SELECT pair_id FROM two_view_geometries"
        )
        if image_id in schema.images_of_pair(number)
    ]
    for number in pairs:
        first, second = schema.images_of_pair(number)
        connection.execute("DELETE FROM matches WHERE pair_id = ?", (number,))
        connection.execute("DELETE FROM two_view_geometries WHERE pair_id = ?", (number,))
        connection.execute(
            "DELETE FROM stereomate_done WHERE kind = 'pair' AND name = ?", (f"{first}-{second}",)
        )
    for table in ("keypoints", "descriptors", "stereomate_tie_points"):
        connection.execute(f"DELETE FROM {table} WHERE image_id = ?", (image_id,))
    connection.execute("DELETE FROM stereomate_done WHERE kind = 'tie points'")
    connection.execute("DELETE FROM stereomate_done WHERE kind = 'features' AND name = ?", (str(image_id),))
    if not keep_image:
        connection.execute("DELETE FROM frame_data WHERE data_id = ?", (image_id,))
        connection.execute("DELETE FROM pose_priors WHERE corr_data_id = ?", (image_id,))
        connection.execute("DELETE FROM images WHERE image_id = ?", (image_id,))
