"""Whether a photograph is the same as before is told without reading large ones whole."""

import numpy as np
import pytest

from stereomate.project.inputs import photo_fingerprint


@pytest.mark.parametrize("size", [0, 1, 1000, 8 << 20])
def test_any_byte_of_a_small_file_counts(tmp_path, size):
    path = tmp_path / "photo.tif"
    content = bytearray(np.random.default_rng(1).bytes(size))
    path.write_bytes(content)
    before = photo_fingerprint(path)
    assert photo_fingerprint(path) == before
    if size:
        content[size * 3 // 7] ^= 1
        path.write_bytes(content)
        assert photo_fingerprint(path) != before
    path.write_bytes(content + b"x")
    assert photo_fingerprint(path) != before


def test_ends_and_long_edits_of_a_large_file_count(tmp_path):
    path = tmp_path / "photo.tif"
    size = (8 << 20) + 4321
    content = bytearray(np.random.default_rng(1).bytes(size))
    path.write_bytes(content)
    found = {photo_fingerprint(path)}
    # Two samples begin 136 KiB apart: an edit longer than the 72 KiB between them cannot be missed.
    for first, last in ((0, 1), (size - 1, size), (1_000_000, 1_080_000), (5_000_001, 5_080_001)):
        edited = bytearray(content)
        edited[first:last] = bytes(b ^ 255 for b in edited[first:last])
        path.write_bytes(edited)
        found.add(photo_fingerprint(path))
    assert len(found) == 5
