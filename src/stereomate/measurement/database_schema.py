"""The tables of a measurement database: those of COLMAP 4, and two of our own that COLMAP passes over."""

from __future__ import annotations

import sqlite3
from typing import Final

# What COLMAP 4.2 writes into `PRAGMA user_version`.
COLMAP_VERSION: Final = 4020100
# Pairs of images have one number: COLMAP's limit of the number of an image.
LARGEST_IMAGE: Final = 2147483647
SENSOR_CAMERA: Final = 0
SIFT: Final = 0
DEGENERATE, CALIBRATED = 1, 2
WGS84: Final = 0

COLMAP_TABLES: Final = """
CREATE TABLE IF NOT EXISTS rigs (
    rig_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    ref_sensor_id INTEGER NOT NULL,
    ref_sensor_type INTEGER NOT NULL);
CREATE UNIQUE INDEX IF NOT EXISTS rig_ref_sensor_assignment ON rigs(ref_sensor_id, ref_sensor_type);
CREATE TABLE IF NOT EXISTS rig_sensors (
    rig_id INTEGER NOT NULL,
    sensor_id INTEGER NOT NULL,
    sensor_type INTEGER NOT NULL,
    sensor_from_rig BLOB,
    FOREIGN KEY(rig_id) REFERENCES rigs(rig_id) ON DELETE CASCADE);
CREATE UNIQUE INDEX IF NOT EXISTS rig_sensor_assignment ON rig_sensors(sensor_id, sensor_type);
CREATE TABLE IF NOT EXISTS cameras (
    camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    model INTEGER NOT NULL,
    width INTEGER NOT NULL,
    height INTEGER NOT NULL,
    params BLOB,
    prior_focal_length INTEGER NOT NULL);
CREATE TABLE IF NOT EXISTS frames (
    frame_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    rig_id INTEGER NOT NULL,
    FOREIGN KEY(rig_id) REFERENCES rigs(rig_id) ON DELETE CASCADE);
CREATE TABLE IF NOT EXISTS frame_data (
    frame_id INTEGER NOT NULL,
    data_id INTEGER NOT NULL,
    sensor_id INTEGER NOT NULL,
    sensor_type INTEGER NOT NULL,
    FOREIGN KEY(frame_id) REFERENCES frames(frame_id) ON DELETE CASCADE);
CREATE UNIQUE INDEX IF NOT EXISTS frame_sensor_assignment ON frame_data(data_id, sensor_type);
CREATE TABLE IF NOT EXISTS images (
    image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    name TEXT NOT NULL UNIQUE,
    camera_id INTEGER NOT NULL,
    CONSTRAINT image_id_check CHECK(image_id >= 0 and image_id < 2147483647),
    FOREIGN KEY(camera_id) REFERENCES cameras(camera_id));
CREATE UNIQUE INDEX IF NOT EXISTS index_name ON images(name);
CREATE TABLE IF NOT EXISTS pose_priors (
    pose_prior_id INTEGER PRIMARY KEY NOT NULL,
    corr_data_id INTEGER NOT NULL,
    corr_sensor_id INTEGER NOT NULL,
    corr_sensor_type INTEGER NOT NULL,
    position BLOB,
    position_covariance BLOB,
    gravity BLOB,
    coordinate_system INTEGER NOT NULL);
CREATE UNIQUE INDEX IF NOT EXISTS pose_prior_data_assignment
    ON pose_priors(corr_data_id, corr_sensor_id, corr_sensor_type);
CREATE TABLE IF NOT EXISTS keypoints (
    image_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL,
    cols INTEGER NOT NULL,
    data BLOB,
    FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE IF NOT EXISTS descriptors (
    image_id INTEGER PRIMARY KEY NOT NULL,
    type INTEGER NOT NULL,
    rows INTEGER NOT NULL,
    cols INTEGER NOT NULL,
    data BLOB,
    FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE IF NOT EXISTS matches (
    pair_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL,
    cols INTEGER NOT NULL,
    data BLOB);
CREATE TABLE IF NOT EXISTS two_view_geometries (
    pair_id INTEGER PRIMARY KEY NOT NULL,
    rows INTEGER NOT NULL,
    cols INTEGER NOT NULL,
    data BLOB,
    config INTEGER NOT NULL,
    F BLOB,
    E BLOB,
    H BLOB,
    qvec BLOB,
    tvec BLOB,
    camera1 BLOB,
    camera2 BLOB);
"""

OWN_TABLES: Final = """
CREATE TABLE IF NOT EXISTS stereomate_done (
    kind TEXT NOT NULL,
    name TEXT NOT NULL,
    key TEXT NOT NULL,
    record TEXT NOT NULL,
    PRIMARY KEY (kind, name));
CREATE TABLE IF NOT EXISTS stereomate_tie_points (
    point INTEGER NOT NULL,
    image_id INTEGER NOT NULL,
    keypoint INTEGER NOT NULL,
    col REAL NOT NULL,
    row REAL NOT NULL,
    sigma_px REAL NOT NULL,
    PRIMARY KEY (point, image_id));
"""


def create_tables(connection: sqlite3.Connection) -> None:
    """Make the tables that are not there yet; an older COLMAP's keep their columns."""
    fresh = not has_table(connection, "images")
    connection.executescript(COLMAP_TABLES + OWN_TABLES)
    if fresh:
        connection.execute(f"PRAGMA user_version = {COLMAP_VERSION}")
        connection.commit()


def has_table(connection: sqlite3.Connection, name: str) -> bool:
    """Whether the database has a table."""
    found = connection.execute("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?", (name,))
    return found.fetchone() is not None


def columns_of(connection: sqlite3.Connection, name: str) -> tuple[str, ...]:
    """Names of a table's columns."""
    return tuple(row[1] for row in connection.execute(f"PRAGMA table_info({name})"))


def pair_number(first: int, second: int) -> int:
    """COLMAP's number of a pair of images, whatever their order."""
    low, high = min(first, second), max(first, second)
    return low * LARGEST_IMAGE + high


def images_of_pair(number: int) -> tuple[int, int]:
    """The two images of a pair, the lower number first."""
    return number // LARGEST_IMAGE, number % LARGEST_IMAGE
