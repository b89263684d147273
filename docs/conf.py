"""Sphinx configuration. Two pages are written from the code before the build: the commands and the API."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

from sphinx.addnodes import pending_xref, pending_xref_condition
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import ReferencesResolver, SphinxPostTransform

DOCS = Path(__file__).parent
PACKAGE = DOCS.parent / "src" / "stereomate"
sys.path.insert(0, str(DOCS))

project = "stereomate"
author = "The stereomate developers"
project_copyright = "The stereomate developers, Apache-2.0"
release = version = "0.1.0"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
]
exclude_patterns = ["_build"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}

# Links to headings are checked down to the third level.
myst_heading_anchors = 3

autosummary_generate = False
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False
# Fields of a dataclass are told once, where its docstring explains them.
napoleon_use_ivar = True
add_module_names = False
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = "stereomate"
html_show_sourcelink = False
html_copy_source = False
# Nothing is fetched from elsewhere: system fonts, no web fonts, no scripts but the theme's own.
html_theme_options = {"top_of_page_buttons": []}

# The layers of the package, top down, as docs/architecture.md has them.
FOLDERS = (
    "project",
    "synthetic",
    "formats",
    "stereo",
    "rectify",
    "parallax",
    "dense",
    "block",
    "relative",
    "measurement",
    "coverage",
    "terrain",
    "frames",
    "camera",
    "tiles",
    "raster",
    "geometry",
)
MODULES = ("errors", "units")
# Modules that a folder shows besides its ``__all__``.
ALSO = {
    "project": ("stereomate.project.run", "stereomate.project.check", "stereomate.project.documents"),
    "raster": ("stereomate.raster.grids",),
}


def api_pages() -> dict[str, str]:
    """The list of folders and a page of each, in the order of the layers.

    A folder that names its interface in ``__all__`` is shown by it, others module by module. Kernels, figures
    and the command line are left out.
    """
    pages: dict[str, str] = {}
    index = [
        *_heading("API reference", "="),
        "What a folder may import, and what travels between folders: :doc:`/architecture`.",
        "These names are offered at the top and imported when first used:",
        "",
        *(f"- ``stereomate.{name}``: :mod:`{module}`" for name, module in _public_names()),
        "",
        ".. toctree::",
        "   :maxdepth: 1",
        "",
    ]
    for folder in (*FOLDERS, *MODULES):
        if (PACKAGE / folder).is_dir():
            text, modules = _docstring(PACKAGE / folder / "__init__.py"), _public_modules(PACKAGE / folder)
        elif (PACKAGE / f"{folder}.py").is_file():
            text, modules = "", [f"stereomate.{folder}"]
        else:
            continue
        pages[f"api_{folder}.rst"] = _folder_page(folder, text, modules)
        index.append(f"   api_{folder}")
    pages["api.rst"] = "\n".join([*index, ""])
    return pages


def _folder_page(folder: str, text: str, modules: list[str]) -> str:
    lines = [*_heading(folder, "="), " ".join(text.split()), "", ".. autosummary::", ""]
    lines += [*(f"   {module}" for module in modules), ""]
    for module in modules:
        lines += _heading(module, "-")
        lines += [f".. automodule:: {module}", "   :members:", "   :show-inheritance:"]
        is_folder = (PACKAGE.parent / module.replace(".", "/")).is_dir()
        lines += ["   :imported-members:", ""] if is_folder else [""]
    return "\n".join(lines)


def _heading(text: str, line: str) -> list[str]:
    return [text, line * len(text), ""]


def _public_modules(folder: Path) -> list[str]:
    inits = [path for path in sorted(folder.rglob("__init__.py")) if "kernels" not in path.parts]
    named = [init.parent for init in inits if "__all__" in init.read_text("utf-8")]
    hidden = {path for parent in named for path in parent.rglob("*.py") if path.parent == parent}
    modules = [".".join(("stereomate", *parent.relative_to(PACKAGE).parts)) for parent in named]
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        if path not in hidden and "kernels" not in parts and parts[-1] != "__init__":
            modules.append(".".join(parts))
    return [*modules, *ALSO.get(folder.name, ())]


def _docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""


def _public_names() -> list[tuple[str, str]]:
    import stereomate

    return sorted(stereomate._PUBLIC.items())


def commands_page() -> str:
    """``stereomate --help`` of every command."""
    from typer.main import get_command
    from typer.testing import CliRunner

    from stereomate.cli.main import application

    app = application()
    runner = CliRunner()

    def help_of(words: list[str]) -> str:
        result = runner.invoke(app, [*words, "--help"], prog_name="stereomate", terminal_width=96)
        if result.exit_code != 0:
            raise RuntimeError(f"stereomate {' '.join(words)} --help: {result.output}")
        return result.output.strip("\n")

    lines = [
        "# Commands",
        "",
        "Written from `stereomate --help`. `-v`, `-q`, `--threads`, `--memory` and `--debug` may stand",
        "before or after any command. Exit codes: 0 done, 2 wrong input or a place that cannot be",
        "written (one line says what), 1 a bug.",
        "",
        "## stereomate",
        "",
        "```text",
        help_of([]),
        "```",
        "",
    ]

    def describe(command: object, words: list[str]) -> None:
        for name, child in getattr(command, "commands", {}).items():
            path = [*words, name]
            lines.extend([f"{'#' * min(len(path) + 1, 4)} stereomate {' '.join(path)}", ""])
            lines.extend(["```text", help_of(path), "```", ""])
            describe(child, path)

    describe(get_command(app), [])
    return "\n".join(lines)


class WordsAreNoLinks(SphinxPostTransform):
    """Types like ``ndarray, shape (n, 2)`` or ``path`` are words: no link to whatever field is called so."""

    default_priority = ReferencesResolver.default_priority - 5

    def run(self, **_: object) -> None:
        for node in list(self.document.findall(pending_xref)):
            is_type = node.get("refdomain") == "py" and node.get("reftype") in ("class", "obj", "exc")
            if is_type and re.fullmatch("[a-z][a-z0-9_]*", node["reftarget"]):
                # The long form of the two that are offered; else the words as they stand.
                last = node.children[-1]
                words = last.children if isinstance(last, pending_xref_condition) else node.children
                node.replace_self(words)


def _write_if_changed(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _write_pages(app: Sphinx, config: object) -> None:
    for name, text in api_pages().items():
        _write_if_changed(DOCS / "_generated" / name, text)
    _write_if_changed(DOCS / "_generated" / "commands.md", commands_page())


def _plain_bars(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """A bar means an absolute value in our docstrings, never a substitution."""
    for number, line in enumerate(lines):
        spans = re.split(r"(``[^`]*``|`[^`]*`)", line)
        lines[number] = "".join(t if t.startswith("`") else t.replace("|", r"\|") for t in spans)


def setup(app: Sphinx) -> None:
    """Sphinx calls this."""
    app.connect("config-inited", _write_pages)
    app.connect("autodoc-process-docstring", _plain_bars)
    app.add_post_transform(WordsAreNoLinks)
