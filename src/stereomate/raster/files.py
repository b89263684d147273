"""Files that are there whole or not at all, and the errors of places that cannot be written."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO

from stereomate.errors import StorageError

Buffer = bytes | bytearray | memoryview


@contextlib.contextmanager
def storing(place: str | os.PathLike[str]) -> Iterator[None]:
    """Turn what the system says about a place that cannot be written into an error that names it.

    Raises
    ------
    StorageError
        For any OSError inside the ``with``.
    """
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(f"{error.filename or place}: {error.strerror or error}") from error


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str], durable: bool = False) -> Iterator[IO[bytes]]:
    """An unbuffered file that takes the place of `path` at the end of the ``with``, or leaves no trace.

    Parameters
    ----------
    path : path
        What is made or replaced. The folder must be there.
    durable : bool
        Have the disk confirm before the file is renamed.

    Raises
    ------
    StorageError
        If it cannot be written: disk full, folder missing or not writable.
    """
    target = Path(path)
    with storing(target):
        # Not mkstemp: its files are private, and the umask cannot be read without setting it.
        name = target.with_name(f".{target.name}.{os.getpid()}-{secrets.token_hex(4)}.part")
        try:
            with open(name, "xb", buffering=0) as file:
                yield file
                if durable:
                    os.fsync(file.fileno())
            os.replace(name, target)
        except BaseException:
            with contextlib.suppress(OSError):
                name.unlink()
            raise


def sweep(folder: Path, name: str = "*") -> None:
    """Remove what killed processes left of the files of a name in a folder; leave that of living ones."""
    for path in folder.glob(f".{name}.*.part"):
        process = path.name.split(".")[-2].split("-")[0]
        if not (process.isdigit() and _is_alive(int(process))):
            path.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    if os.name != "posix" or process == os.getpid():
        # On Windows the question would end the process; a file of this one is being written by a thread.
        return os.name == "posix"
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def write_all(file: IO[bytes], parts: Iterable[Buffer]) -> None:
    """Write every byte of every part; a raw file may take fewer at a time."""
    for part in parts:
        view = memoryview(part).cast("B")
        while view:
            view = view[file.write(view) or 0 :]


def write_whole(path: str | os.PathLike[str], parts: Iterable[Buffer], durable: bool = False) -> None:
    """Write a file that is there whole or not at all; see `replacing`."""
    with replacing(path, durable) as file:
        write_all(file, parts)
