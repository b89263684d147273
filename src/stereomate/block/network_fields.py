"""Checks of the fields of a network, and arrays of its own for each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereomate.errors import InputError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


def own(owner: Any, name: str, dtype: Any, shape: tuple[int, ...]) -> None:
    """Keep a field as a read-only contiguous array of its own, broadcast to its shape."""
    field_name = f"{type(owner).__name__.lower()}.{name}"
    given = np.asarray(getattr(owner, name))
    if dtype is np.int64 and given.size and not np.issubdtype(given.dtype, np.integer):
        raise InputError("must be integers", field=field_name, value=str(given.dtype))
    try:
        value = np.array(np.broadcast_to(given.astype(dtype), shape), order="C")
    except ValueError:
        raise InputError(f"must have shape {shape}", field=field_name, value=given.shape) from None
    value.flags.writeable = False
    object.__setattr__(owner, name, value)


def own_mount(owner: Any, g: int) -> None:
    """Groups of lever arms and misalignments, numbered from 0; all are one where nothing is said."""
    if owner.mount is None:
        object.__setattr__(owner, "mount", np.zeros(g, np.int64))
    own(owner, "mount", np.int64, (g,))
    assert owner.mount is not None
    if owner.mount.size and owner.mount.min() < 0:
        field_name = f"{type(owner).__name__.lower()}.mount"
        raise InputError("must not be negative", field=field_name, value=int(owner.mount.min()))


def finite(name: str, values: Array, names: tuple[str, ...] = ()) -> None:
    """Whether a field is finite, row by row; named by its row."""
    if not values.size:
        return
    bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
    if len(bad):
        which = names[bad[0]] if names else int(bad[0])
        raise InputError("must be finite", field=name, value=which)


def positive(name: str, values: Array) -> None:
    """Whether a field is positive."""
    if not np.all(values > 0.0):
        raise InputError("must be positive", field=name, value=float(np.nanmin(values)))


def within(name: str, index: Integers, count: int) -> None:
    """Whether a field holds indices of what there is."""
    if index.size and not (index.min() >= 0 and index.max() < count):
        raise InputError(f"must be an index below {count}", field=name, value=int(index.max()))


def first_twice(names: tuple[str, ...]) -> str | None:
    """The first name that comes again."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None
