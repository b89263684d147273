"""The exceptions of stereomate.

Wrong input raises; poor results are values (a diverged adjustment is a summary that says so). Every
class can also be caught as the builtin it derives from. The table in ``docs/errors.md`` lists them.
"""

from __future__ import annotations

from typing import Any

_UNSET: Any = object()


class StereomateError(Exception):
    """Base of everything stereomate raises on purpose."""


class InputError(StereomateError, ValueError):
    """Input that breaks a rule.

    Parameters
    ----------
    rule : str
        What must hold, as a sentence part: ``"must be two positive integers"``.
    file : str or path-like, optional
        The file the input came from.
    field : str, optional
        The key, column, argument or record inside it.
    value : object, optional
        What came instead.
    hint : str, optional
        What to do about it.
    """

    def __init__(
        self,
        rule: str,
        *,
        file: object | None = None,
        field: str | None = None,
        value: object = _UNSET,
        hint: str | None = None,
    ) -> None:
        self.rule, self.file, self.field, self.hint = rule, file, field, hint
        self.value = None if value is _UNSET else value
        place = ": ".join(str(part) for part in (file, field) if part is not None)
        text = f"{place}: {rule}" if place else rule
        if value is not _UNSET:
            text += f", got {value!r}"
        if hint:
            text += f" ({hint})"
        super().__init__(text)


class ProjectError(InputError):
    """A project file, or an option, that breaks a rule."""


class FormatError(InputError):
    """A file of an external format that is malformed, ambiguous, or newer than this version reads."""


class OrientationError(InputError):
    """Orientations that cannot be right, or that do not belong to the photographs."""


class CrsError(InputError):
    """A coordinate reference system that cannot serve: not conformal, geographic, unknown."""


class HeightSystemError(InputError):
    """Heights that cannot be brought to one system."""


class MissingGridError(HeightSystemError, FileNotFoundError):
    """A geoid or datum grid that is not on this machine. Never replaced by zero."""


class CoverageError(InputError):
    """Photographs, height model and area that do not meet."""


class ImageError(InputError):
    """A raster that is missing, truncated, or of a kind that cannot be used."""


class StorageError(StereomateError, OSError):
    """A place that cannot be written: disk full, unwritable folder."""


class NotDeterminedError(StereomateError, ArithmeticError):
    """A question whose answer the geometry does not determine."""
