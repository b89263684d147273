"""The ledger: what is there is whole; what is damaged is made again; other people's files are left alone."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stereomate.errors import FormatError, StorageError
from stereomate.forms import LEDGER
from stereomate.tiles import Ledger, run_key

BLOBS = {"ortho": b"abc" * 100, "mate": b"", "lineage": bytes(range(256))}


def chunk_file(ledger: Ledger, index: int = 3):
    return ledger.folder / "chunks" / f"{index:06d}.chunk"


def test_blobs_come_back_also_in_the_next_session(tmp_path):
    ledger = Ledger.open(tmp_path / "ledger", "k")
    assert not ledger.has(3)
    ledger.put(3, {"ortho": bytearray(BLOBS["ortho"]), "mate": b"", "lineage": memoryview(BLOBS["lineage"])})
    for view in (ledger, Ledger.open(tmp_path / "ledger", "k")):
        assert view.has(3)
        assert view.names(3) == tuple(BLOBS)
        assert {name: view.get(3, name) for name in BLOBS} == BLOBS
        assert view.read(3, "lineage", 10, 5) == bytes(range(10, 15))
        with pytest.raises(ValueError, match="outside blob"):
            view.read(3, "lineage", 250, 7)
        with pytest.raises(KeyError):
            view.get(4, "ortho")


def test_another_key_starts_afresh(tmp_path):
    Ledger.open(tmp_path, "k").put(3, BLOBS)
    assert not Ledger.open(tmp_path, "other").has(3)
    assert not Ledger.open(tmp_path, "k").has(3)


@given(st.data())
@settings(deadline=None, max_examples=60)
def test_any_damaged_byte_and_any_cut_is_found(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("ledger")
    ledger = Ledger.open(folder, "k")
    ledger.put(3, BLOBS)
    path = chunk_file(ledger)
    content = bytearray(path.read_bytes())
    if data.draw(st.booleans()):
        content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    else:
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    path.write_bytes(content)
    again = Ledger.open(folder, "k")
    assert not again.has(3)
    again.put(3, BLOBS)
    assert Ledger.open(folder, "k").get(3, "lineage") == BLOBS["lineage"]


def test_a_newer_ledger_is_an_error_that_names_both_formats(tmp_path):
    Ledger.open(tmp_path, "k")
    (tmp_path / "manifest.json").write_text(json.dumps({"format": LEDGER.version + 1, "key": "k"}))
    with pytest.raises(FormatError, match=rf"form {LEDGER.version + 1}.*form {LEDGER.version}"):
        Ledger.open(tmp_path, "k")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "1"}'])
def test_a_manifest_that_makes_no_sense_is_an_error(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(FormatError, match=r"manifest\.json"):
        Ledger.open(tmp_path, "k")


def test_chunks_without_a_manifest_are_not_deleted(tmp_path):
    (tmp_path / "chunks").mkdir()
    other = tmp_path / "chunks" / "mine.chunk"
    other.write_text("precious")
    with pytest.raises(StorageError, match="without a manifest"):
        Ledger.open(tmp_path, "k")
    assert other.exists()


def test_a_place_below_a_file_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file"):
        Ledger.open(tmp_path / "file" / "ledger", "k")


def test_a_full_disk_is_an_error_and_leaves_nothing(tmp_path, monkeypatch):
    ledger = Ledger.open(tmp_path, "k")

    def full(source, target):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), source)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(StorageError, match="No space left"):
        ledger.put(3, BLOBS)
    assert not ledger.has(3)
    assert list((tmp_path / "chunks").iterdir()) == []


def test_remains_of_a_killed_writer_are_swept_away(tmp_path):
    ledger = Ledger.open(tmp_path, "k")
    job = subprocess.Popen([sys.executable, "-c", ""])
    job.wait()
    (tmp_path / "chunks" / f".000001.chunk.{job.pid}-01234567.part").write_bytes(b"half")
    alive = tmp_path / "chunks" / f".000001.chunk.{os.getppid()}-01234567.part"
    alive.write_bytes(b"being written by another process")
    Ledger.open(tmp_path, "k")
    assert list((tmp_path / "chunks").iterdir()) == [alive]
    alive.unlink()
    ledger.put(0, BLOBS)
    ledger.remove()
    assert not tmp_path.exists()


def test_removing_a_ledger_leaves_other_files(tmp_path):
    ledger = Ledger.open(tmp_path, "k")
    (tmp_path / "notes.txt").write_text("mine")
    ledger.remove()
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_the_key_depends_on_every_value_and_not_on_their_order():
    assert run_key(a=1, b=[0.1, "x"]) == run_key(b=[0.1, "x"], a=1)
    keys = {run_key(a=1), run_key(a=1.0), run_key(a="1"), run_key(b=1), run_key(a=1.0000000000000002)}
    assert len(keys) == 5
