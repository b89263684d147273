"""A report page as PDF, by WeasyPrint (the extra ``pdf``)."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from stereomate.errors import InputError
from stereomate.raster.files import write_whole


def write_pdf(page: Path, target: Path) -> None:
    """Print a report page, A4, whole or not at all; scripts do not run, nothing is fetched.

    Raises
    ------
    InputError
        If WeasyPrint or the system library that it needs is missing, or there is no page.
    StorageError
        If the file cannot be written.
    """
    if not page.is_file():
        raise InputError("does not exist: a run writes it", file=page)
    weasyprint = _weasyprint()
    # A report holds all that it shows: data URIs are read, and nothing else.
    fetcher = weasyprint.urls.URLFetcher(allowed_protocols={"data"})
    document = weasyprint.HTML(string=page.read_text(encoding="utf-8"), url_fetcher=fetcher)
    sheet = weasyprint.CSS(string="@page { size: A4; margin: 15mm 14mm; } main { padding: 0; }")
    write_whole(target, [document.write_pdf(stylesheets=[sheet])])


def _weasyprint() -> Any:
    try:
        return importlib.import_module("weasyprint")
    except ModuleNotFoundError:
        raise InputError(
            "needs WeasyPrint",
            field="--pdf",
            hint="pip install 'stereomate[pdf]', or print the page in a browser",
        ) from None
    except OSError as error:
        raise InputError(
            f"needs the system library Pango: {str(error).splitlines()[0]}",
            field="--pdf",
            hint="on Debian and Ubuntu: apt-get install libpango-1.0-0 libpangoft2-1.0-0",
        ) from error
