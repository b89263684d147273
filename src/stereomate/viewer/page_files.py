"""The page itself as files: its modules joined into one; index.html names what is wanted at once.

The modules are plain ES modules and stay what is edited; a browser that finds them one inside the other asks
for thirty files before it draws. They are joined here, by nothing but their import and export statements.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from html import escape
from importlib import resources
from pathlib import Path, PurePosixPath
from posixpath import dirname, join, normpath
from typing import Final

from stereomate.errors import FormatError

# All modules as one file, and the module that starts the page.
JOINED: Final = "page.js"
_MAIN: Final = "main.js"
_IMPORT: Final = re.compile(r"^import \{([^}]*)\} from '(\.[^']+)';\n", re.MULTILINE)
_EXPORT: Final = re.compile(r"^export (?=(?:(?:async )?function|class|const) ([\w$]+))", re.MULTILINE)
_OTHER: Final = re.compile(r"^(?:import|export)\b.*", re.MULTILINE)
_COMMENT: Final = re.compile(r"^ *//.*\n", re.MULTILINE)


@functools.cache
def page_names() -> tuple[str, ...]:
    """Files of the page, as it is asked for."""
    return tuple(sorted({*(name for name in _sources() if not name.endswith(".js")), JOINED}))


def read_page(name: str, first: tuple[str, ...] = ()) -> bytes:
    """A file of the page.

    Parameters
    ----------
    name : str
        Also a module by itself can be read.
    first : tuple of str
        What the first page says is wanted at once: addresses relative to it.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    if name == JOINED:
        return _joined()
    if name not in _sources():
        raise KeyError(name)
    content = (_folder() / PurePosixPath(name)).read_bytes()
    return _with_first(content.decode(), first).encode() if name == "index.html" else content


def _with_first(page: str, first: tuple[str, ...]) -> str:
    links = "".join(
        f'<link rel="preload" as="fetch" href="{escape(address)}" crossorigin="anonymous">\n'
        for address in first
    )
    before, script, after = page.partition(f'src="{_MAIN}" blocking="render"></script>\n')
    if not script:
        raise FormatError(f"does not start {_MAIN}", file=Path("index.html"))
    return f"{before}{script.replace(_MAIN, JOINED)}{links}{after}"


@functools.cache
def _sources() -> tuple[str, ...]:
    folder = _folder()
    return tuple(
        path.relative_to(folder).as_posix()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix in (".html", ".css", ".js")
    )


def _folder() -> Path:
    return Path(str(resources.files("stereomate.viewer") / "page"))


@functools.cache
def _joined() -> bytes:
    modules = {
        name: (_folder() / name).read_text(encoding="utf-8") for name in _sources() if name.endswith(".js")
    }
    return joined_modules(modules, _MAIN).encode()


def joined_modules(modules: Mapping[str, str], main: str) -> str:
    """One module that does what `main` does with all that it imports.

    Each module becomes a function that gives its exports, called once, after those that it imports from. A
    module may import names by ``import { a, b as c } from './x.js'`` and export functions, classes and
    constants where they are declared.

    Raises
    ------
    FormatError
        If a module is missing, imports itself by way of others, imports what another does not export, or
        imports or exports otherwise.
    """
    parts: list[str] = []
    done: dict[str, set[str]] = {}

    def add(name: str, path: tuple[str, ...]) -> None:
        if name in path:
            raise FormatError(f"imports itself: {' > '.join((*path, name))}", file=Path(name))
        if name in done:
            return
        if name not in modules:
            raise FormatError("is imported and does not exist", file=Path(name))
        text = modules[name]
        taken = []
        for match in _IMPORT.finditer(text):
            other = normpath(join(dirname(name), match[2]))
            add(other, (*path, name))
            taken.append(_taken(name, match[1], other, done[other]))
        body = _IMPORT.sub("", text)
        exports = [match[1] for match in _EXPORT.finditer(body)]
        body = _COMMENT.sub("", _EXPORT.sub("", body))
        if strange := _OTHER.search(body):
            raise FormatError(
                "imports or exports in a way that is not joined", file=Path(name), value=strange[0]
            )
        done[name] = set(exports)
        head = "".join(taken)
        if name == main:
            parts.append(f"{head}{body}")
        else:
            given = f"return {{ {', '.join(exports)} }};\n"
            parts.append(f"const {_variable(name)} = (() => {{\n{head}{body}{given}}})();\n")

    add(main, ())
    return "\n".join(parts)


def _taken(name: str, imported: str, other: str, exports: set[str]) -> str:
    pairs = []
    for item in filter(None, (part.strip() for part in imported.split(","))):
        source, _, local = item.partition(" as ")
        if source not in exports:
            raise FormatError(f"imports {source}, which {other} does not export", file=Path(name))
        pairs.append(f"{source}: {local}" if local else source)
    return f"const {{ {', '.join(pairs)} }} = {_variable(other)};\n"


def _variable(name: str) -> str:
    return "module_" + re.sub(r"\W", "_", name.removesuffix(".js"))
