"""Versions of the files that stereomate writes and reads again, and how an older one becomes the present one.

The one place for both: a form's version is one more than the number of its migrations, so it cannot rise
without one. A migration is a pure function from a document of one version to that of the next; it knows
nothing of the code that reads documents today and is never changed again. The examples in ``tests/forms`` are
frozen with it.

What raises a version: a key that older readers refuse, miss or would misread. A key of the project file that
may be left out does not: a file that leaves it out is of the same form as ever.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from stereomate.errors import FormatError

Document = dict[str, Any]
Migration = Callable[[Document], Document]


@dataclass(frozen=True)
class Form:
    """A versioned form of file.

    Attributes
    ----------
    name : str
        What a message calls it.
    migrations : tuple of functions
        The first turns version 1 into 2, and so on.
    section : str or None
        The table of the document that holds ``format``; None: the document itself.
    may_be_absent : bool
        A document without ``format`` is of version 1.
    """

    name: str
    migrations: tuple[Migration, ...] = ()
    section: str | None = None
    may_be_absent: bool = False

    @property
    def version(self) -> int:
        """The version that is written today."""
        return 1 + len(self.migrations)

    @property
    def field(self) -> str:
        """Where ``format`` stands."""
        return "format" if self.section is None else f"{self.section}.format"

    def migrated(self, document: Mapping[str, Any], file: object) -> Document:
        """The document in the present version; what is passed in is left as it is.

        Parameters
        ----------
        document : mapping
        file : path
            Only named in messages.

        Raises
        ------
        FormatError
            If ``format`` is no version, or a newer one than this stereomate reads; both are named.
        """
        holder = document if self.section is None else document.get(self.section)
        found: Any = holder.get("format") if isinstance(holder, Mapping) else None
        if found is None and self.may_be_absent:
            found = 1
        if isinstance(found, bool) or not isinstance(found, int) or found < 1:
            raise FormatError("must be a whole number from 1", file=file, field=self.field, value=found)
        if found > self.version:
            raise FormatError(
                f"is of form {found}; this stereomate reads {self.name} of form {self.version} and older",
                file=file,
                field=self.field,
                hint="install a newer stereomate",
            )
        result = dict(document)
        for migration in self.migrations[found - 1 :]:
            result = migration(result)
        if found < self.version and self.section is None:
            return {**result, "format": self.version}
        if found < self.version and self.section is not None:
            return {**result, self.section: {**result[self.section], "format": self.version}}
        return result


def stereo_1_to_2(document: Document) -> Document:
    """Seams and radiometric balance, which products of the first form do not have, are said to be absent."""
    plain = {"seams": "nearest", "feather_px": 0.0, "balance": False}
    products = [
        {"seams": None, "balance": None, **product, "options": {**plain, **product["options"]}}
        for product in document["products"]
    ]
    return {**document, "products": products}


def stereo_2_to_3(document: Document) -> Document:
    """Balance without a local part, and seams at which brightness is not levelled."""

    def migrated(product: Document) -> Document:
        seams, balance = product["seams"], product["balance"]
        if seams is not None:
            seams = {**seams, "mixed": [{**line, "levels": []} for line in seams["mixed"]]}
        return {**product, "seams": seams, "balance": balance and {"coefficients": balance, "local": []}}

    return {**document, "products": [migrated(product) for product in document["products"]]}


def stereo_3_to_4(document: Document) -> Document:
    """Products whose orientations have no stated covariance."""
    products = [{**product, "orientation_covariance": None} for product in document["products"]]
    return {**document, "products": products}


PROJECT: Final = Form("project file", section="project", may_be_absent=True)
STEREO: Final = Form("stereo.json", (stereo_1_to_2, stereo_2_to_3, stereo_3_to_4))
LEDGER: Final = Form("tile ledger")
RUN_REPORT: Final = Form("report.json")
RUN_PAGE: Final = Form("report.html")
ORIENTATION: Final = Form("adjustment.json")
ORIENTATION_COVARIANCE: Final = Form("orientation_covariance.json")
PAIR: Final = Form("relative orientation")
PAGE: Final = Form("viewer's product.json")
FORMS: Final = (PROJECT, STEREO, LEDGER, RUN_REPORT, RUN_PAGE, ORIENTATION, PAIR, PAGE)
