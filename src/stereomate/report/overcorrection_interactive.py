"""The drawing of the over-correction factor as an HTML fragment in which the points can be dragged."""

from __future__ import annotations

import html
import json
import re
from importlib import resources

import jinja2

from stereomate.errors import InputError
from stereomate.relative.drawing import SectionDrawing


def interactive_fragment(
    drawing: SectionDrawing, identifier: str = "overcorrection", heading: str = ""
) -> str:
    """A ``<div>`` with everything in it: style, data and script; needs no network and no library.

    Parameters
    ----------
    drawing : SectionDrawing
        Where the points begin; with a profile they can be held on the terrain.
    identifier : str
        Id of the element, one per fragment of a page.
    heading : str
        Sentence before the instructions, plain text.

    Raises
    ------
    InputError
        If the identifier is no plain name.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", identifier):
        raise InputError(
            "must be letters, digits, - and _, a letter first", field="identifier", value=identifier
        )
    data = {
        "section": drawing.section.tolist(),
        "numbers": list(drawing.numbers),
        "roles": list(drawing.roles),
        "profile": None if drawing.profile is None else drawing.profile.tolist(),
    }
    folder = resources.files("stereomate.report")
    template = jinja2.Template(
        (folder / "overcorrection_interactive.html").read_text(encoding="utf-8"), keep_trailing_newline=True
    )
    fragment: str = template.render(
        identifier=identifier,
        heading=html.escape(heading),
        numbers=", ".join(str(number) for number in drawing.numbers),
        has_profile=drawing.profile is not None,
        # A closing tag inside a script element would end it.
        data=json.dumps(data).replace("</", "<\\/"),
        # The script declares its name once however many fragments a page has.
        script=_once((folder / "overcorrection_interactive.js").read_text(encoding="utf-8")),
    )
    return fragment


def interactive_page(drawing: SectionDrawing, title: str = "Over-correction factor") -> str:
    """A whole page with the fragment in it."""
    head = f'<meta charset="utf-8">\n<title>{html.escape(title)}</title>'
    head += '\n<meta name="viewport" content="width=device-width, initial-scale=1">'
    body = interactive_fragment(drawing)
    return f'<!DOCTYPE html>\n<html lang="en">\n<head>\n{head}\n</head>\n<body>\n{body}\n</body>\n</html>\n'


def _once(script: str) -> str:
    return script.replace('"use strict";\n', "", 1).replace(
        "const StereomateOverCorrection =",
        "var StereomateOverCorrection = window.StereomateOverCorrection ||",
        1,
    )
