"""Examples of the documentation run, and its lists are complete."""

from __future__ import annotations

import ast
import doctest
import re
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from pages import ROOT, blocks

DOCS = ROOT / "docs"
# Those of the build are left out.
PAGES = [
    p for p in sorted(DOCS.rglob("*.md")) if p.relative_to(DOCS).parts[0] not in ("_build", "_generated")
]
MANUALS = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "NOTICE")]


def test_examples_of_the_conventions_hold():
    page = DOCS / "conventions.md"
    texts = blocks(page, "pycon")
    test = doctest.DocTestParser().get_doctest("\n".join(texts), {}, page.name, str(page), 0)
    output: list[str] = []
    result = doctest.DocTestRunner(verbose=False).run(test, out=output.append)
    assert result.failed == 0, "".join(output)
    assert result.attempted >= 15


def _project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def _names(requirements: list[str]) -> set[str]:
    return {Requirement(text).name for text in requirements}


def test_every_dependency_has_its_reason():
    declared = _names(_project()["dependencies"])
    for extra in _project()["optional-dependencies"].values():
        declared |= _names(extra)
    rows = [
        line.split("|")
        for line in (DOCS / "dependencies.md").read_text().splitlines()
        if line.startswith("| ")
    ]
    explained = {cell.strip() for row in rows for cell in row[1:3]}
    assert declared - explained == set()
    listed = {row[2].strip() if row[1].strip().startswith("`") else row[1].strip() for row in rows}
    assert listed - declared == {"package", "extra"}  # the heads of the tables


def test_what_is_imported_is_declared():
    """Every import of another package stands in pyproject.toml, those of extras inside functions."""
    module_of = {"opencv-python-headless": "cv2"}
    core = {module_of.get(name, name) for name in _names(_project()["dependencies"])}
    extras = {
        name
        for group, names in _project()["optional-dependencies"].items()
        if group != "dev"
        for name in _names(names)
    }
    for source in sorted((ROOT / "src").rglob("*.py")):
        tree = ast.parse(source.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            else:
                continue
            for name in {name.split(".")[0] for name in names} - core - set(sys.stdlib_module_names):
                assert name in extras | {"stereomate"}, f"{source}: imports {name}, which is not declared"
                if name in extras:
                    assert node not in tree.body, f"{source}: imports the extra {name} at its top"


def test_every_page_is_in_a_table_of_contents():
    listed = {DOCS / "index.md"}
    for page in PAGES:
        for entries in blocks(page, "{toctree}"):
            for name in re.findall(r"^([\w/*]+)$", entries, flags=re.MULTILINE):
                listed |= set(page.parent.glob(f"{name}.md"))
    assert set(PAGES) - listed == set()


@pytest.mark.parametrize("page", [*MANUALS, *PAGES], ids=lambda page: page.name)
def test_links_to_files_lead_somewhere(page: Path):
    for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
        if not target.startswith("http") and "_generated" not in target:
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_version_is_said_once():
    import stereomate

    assert _project()["version"] == stereomate.__version__
    for name, pattern in (
        ("CITATION.cff", r"^version: (\S+)$"),
        ("docs/conf.py", r'^release = version = "(\S+)"$'),
    ):
        found = re.search(pattern, (ROOT / name).read_text(), flags=re.MULTILINE)
        assert found is not None
        assert found[1] == stereomate.__version__
