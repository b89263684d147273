"""Reading a project file: TOML, versions of the form, and what is said about keys that break a rule."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import ValidationError

from stereomate import forms
from stereomate.errors import ProjectError
from stereomate.project.schema import ProjectFile, Section

Model = TypeVar("Model", bound=Section)


def read_project_file(path: Path) -> ProjectFile:
    """The project file, parsed, migrated to the newest form and checked.

    Raises
    ------
    ProjectError
        If the file is missing, not TOML, or breaks a rule: file, key, rule and value are named.
    FormatError
        If it was written for a newer stereomate, or its ``format`` is no version.
    """
    return parse_project(read_toml(path), path)


def read_toml(path: Path) -> dict[str, Any]:
    """The TOML document of a file."""
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        raise ProjectError("does not exist", file=path) from None
    except IsADirectoryError:
        rule = "is a folder, not a project file"
        raise ProjectError(rule, file=path, hint=f"stereomate init {path} drafts one") from None
    except OSError as error:
        raise ProjectError(f"cannot be read: {error.strerror}", file=path) from error
    except UnicodeDecodeError as error:
        raise ProjectError(f"must be UTF-8 text: {error.reason} at byte {error.start}", file=path) from error
    except tomllib.TOMLDecodeError as error:
        raise ProjectError(f"must be TOML: {error}", file=path) from error


def parse_project(document: Mapping[str, Any], path: Path) -> ProjectFile:
    """A project file from its TOML document; `path` is only named in messages."""
    return validated(ProjectFile, forms.PROJECT.migrated(document, path), path)


def validated(model: type[Model], document: Mapping[str, Any], path: Path) -> Model:
    """A model from a document, pydantic's complaints turned into one `ProjectError`."""
    try:
        return model.model_validate(document)
    except ValidationError as error:
        complaints = error.errors(include_url=False)
        first = _project_error(model, complaints[0], path)
        fields = [_field(model, complaint["loc"]) or "the file" for complaint in complaints]
        others = [field for field in dict.fromkeys(fields) if field != fields[0]]
        if others:
            hint = f"{first.hint}; " if first.hint else ""
            hint += f"also wrong: {', '.join(others)}"
            first = ProjectError(first.rule, file=path, field=first.field, hint=hint, **_value(first))
        raise first from None


def _value(error: ProjectError) -> dict[str, Any]:
    return {} if error.value is None else {"value": error.value}


def _field(model: type[Section], location: tuple[int | str, ...]) -> str:
    """``camera[1].size_px[2]`` from a location; union members that pydantic tried are left out."""
    text = ""
    current: type[Section] | None = model
    for part in location:
        if isinstance(part, int):
            text += f"[{part + 1}]"
        elif current is None or part in current.model_fields or part == location[-1]:
            if "[" in part or "-" in part or part in _UNION_MEMBERS:
                continue
            text += f".{part}" if text else part
            field = current.model_fields.get(part) if current else None
            current = _section_inside(field.annotation) if field else None
    return text


_UNION_MEMBERS: Final = frozenset({"float", "str", "int"})


def _project_error(model: type[Section], complaint: Any, path: Path) -> ProjectError:
    kind, location = complaint["type"], complaint["loc"]
    field = _field(model, location) or None
    if kind == "extra_forbidden":
        known = _known_keys(model, location[:-1])
        close = difflib.get_close_matches(str(location[-1]), known, n=1)
        hint = f"did you mean {close[0]}?" if close else f"known keys: {', '.join(known)}"
        return ProjectError("is not a key of the project file", file=path, field=field, hint=hint)
    if kind == "missing" and isinstance(location[-1], int):
        return ProjectError("has too few values", file=path, field=_field(model, location[:-1]))
    if kind == "missing":
        return ProjectError("must be given", file=path, field=field, hint=_HINTS.get(field or ""))
    if field in _UNION_RULES:
        return ProjectError(_UNION_RULES[field], file=path, field=field, value=complaint["input"])
    if kind == "too_long":
        return ProjectError("has too many values", file=path, field=field, value=complaint["input"])
    if kind in _KINDS:
        return ProjectError(_KINDS[kind], file=path, field=field, value=complaint["input"])
    rule = complaint["msg"].removeprefix("Value error, ").removeprefix("Input ")
    rule = rule[:1].lower() + rule[1:]
    if kind == "value_error":
        return ProjectError(rule, file=path, field=field)
    rule = rule.removeprefix("should ").replace("'", '"')
    rule = rule if rule.startswith("must") else f"must {rule}"
    return ProjectError(rule, file=path, field=field, value=complaint["input"])


_KINDS: Final = {
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "tuple_type": "must be a list",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "string_type": "must be text",
    "bool_type": "must be true or false",
}
_HINTS: Final = {
    "project.heights": '"ellipsoidal", a vertical CRS ("EPSG:5773"), a geoid grid file, or "undeclared"',
    "project.crs": "anything PROJ takes: EPSG:32651, a PROJ string, WKT",
    "photos.orientation": "the table of orientations, or reconstruction.json",
}
_UNION_RULES: Final = {
    "camera": "must be written as [[camera]], once per camera",
    "products.rotation": 'must be "auto", "north-up" or degrees',
    "photos.files": "must be a pattern or a list of patterns",
}


def _known_keys(model: type[Section], location: tuple[int | str, ...]) -> list[str]:
    current: Any = model
    for part in location:
        if isinstance(part, int):
            continue
        found = _section_inside(current.model_fields[part].annotation)
        if found is None:
            return []
        current = found
    return list(current.model_fields)


def _section_inside(annotation: Any) -> type[Section] | None:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        found = _section_inside(argument)
        if found is not None:
            return found
    return None
