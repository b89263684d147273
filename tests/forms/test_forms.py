"""Versioned files: frozen examples of every form still load, older ones are migrated, newer ones refused.

The files in ``frozen/`` are what stereomate wrote at that version, never made anew: who raises a version in
`stereomate.forms` adds a file beside them.
"""

from __future__ import annotations

import copy
import json
import re
import shutil
from pathlib import Path

import pytest

from stereomate import forms
from stereomate.errors import FormatError
from stereomate.forms import Form
from stereomate.project.reading import parse_project, read_project_file, read_toml
from stereomate.project.run_record import read_run_record
from stereomate.stereo import record
from stereomate.stereo.product import product_record, read_products
from stereomate.tiles.ledger import Ledger

FROZEN = Path(__file__).parent / "frozen"
# Forms that are read again, and the stem of their frozen files.
READ = {forms.PROJECT: "project", forms.STEREO: "stereo", forms.RUN_REPORT: "report", forms.LEDGER: "ledger"}


def read(form: Form, path: Path) -> object:
    if form is forms.PROJECT:
        return read_project_file(path)
    if form is forms.STEREO:
        return read_products(path)
    if form is forms.RUN_REPORT:
        return read_run_record(path)
    return Ledger.open(path, "k")


def placed(form: Form, number: int, folder: Path) -> Path:
    """A copy of the frozen example, as a person has it."""
    (source,) = FROZEN.glob(f"{READ[form]}_{number}*")
    if source.is_dir():
        return Path(shutil.copytree(source, folder / source.name))
    return Path(shutil.copy(source, folder))


@pytest.mark.parametrize("form", READ, ids=READ.values())
def test_every_version_has_its_frozen_example_and_loads(form, tmp_path):
    for number in range(1, form.version + 1):
        assert read(form, placed(form, number, tmp_path))
    assert len(list(FROZEN.glob(f"{READ[form]}_*"))) == form.version


@pytest.mark.parametrize("form", READ, ids=READ.values())
def test_a_newer_version_is_refused_by_an_error_that_names_both(form, tmp_path):
    path = placed(form, form.version, tmp_path)
    newer = form.version + 6
    document = path / "manifest.json" if path.is_dir() else path
    text, count = re.subn(r'(\bformat"?\s*[:=]\s*)\d+', rf"\g<1>{newer}", document.read_text(), count=1)
    assert count == 1
    document.write_text(text)
    message = (
        rf"{document.name}: .*format: is of form {newer}; .*{form.name} of form {form.version} and older"
    )
    with pytest.raises(FormatError, match=message):
        read(form, path)
    assert document.read_text() == text


@pytest.mark.parametrize("version", ["1", 0, 1.5, True, None])
@pytest.mark.parametrize("form", [f for f in forms.FORMS if f is not forms.PROJECT], ids=lambda f: f.name)
def test_what_is_no_version_is_refused(form, version):
    with pytest.raises(FormatError, match="format: must be a whole number from 1"):
        form.migrated({"format": version}, "file")


def test_absent_format_of_a_project_means_the_first(tmp_path):
    document = read_toml(FROZEN / "project_1.toml")
    del document["project"]["format"]
    assert parse_project(document, Path("p.toml")) == read_project_file(FROZEN / "project_1.toml")


def test_chain_of_migrations_runs_from_where_a_document_stands():
    """Every step once, in order, and the document that was passed in is not touched."""
    chain = Form(
        "thing", (lambda d: {**d, "said": [*d["said"], 1]}, lambda d: {**d, "said": [*d["said"], 2]})
    )
    assert chain.version == 3
    for start, said in ((1, [1, 2]), (2, [2]), (3, [])):
        document = {"format": start, "said": []}
        assert chain.migrated(document, "file") == {"format": 3, "said": said}
        assert document == {"format": start, "said": []}


def test_migrated_section_carries_the_present_version():
    form = Form("thing", (lambda d: {**d, "new": 1},), section="project", may_be_absent=True)
    assert form.migrated({"project": {"name": "n"}}, "file") == {
        "project": {"name": "n", "format": 2},
        "new": 1,
    }


# --- stereo.json 1 -> 2: seams and balance ----------------------------------------------------------------


def test_products_of_the_first_form_have_no_seams_and_no_balance():
    document = json.loads((FROZEN / "stereo_1.json").read_text())
    before = copy.deepcopy(document)
    after = forms.stereo_1_to_2(document)
    assert document == before
    (old,), (new,) = before["products"], after["products"]
    assert (new["seams"], new["balance"]) == (None, None)
    assert {k: v for k, v in new["options"].items() if k not in old["options"]} == {
        "seams": "nearest",
        "feather_px": 0.0,
        "balance": False,
    }
    assert {k: new[k] for k in old if k != "options"} == {k: old[k] for k in old if k != "options"}


def test_the_balance_of_the_second_form_has_no_local_part():
    document = json.loads((FROZEN / "stereo_2.json").read_text())
    after = forms.stereo_2_to_3(document)
    (old,), (new,) = document["products"], after["products"]
    assert new["balance"] == {"coefficients": old["balance"], "local": []}
    mixed = [{**line, "levels": []} for line in old["seams"]["mixed"]]
    assert mixed
    assert new["seams"] == {**old["seams"], "mixed": mixed}
    (product,) = read_products(FROZEN / "stereo_2.json")
    found = product.job.balance
    assert (found.coefficients[0][0], found.local) == (tuple(old["balance"][0][0]), ())


def test_orientations_of_the_third_form_have_no_covariance():
    document = json.loads((FROZEN / "stereo_3.json").read_text())
    after = forms.stereo_3_to_4(document)
    (old,), (new,) = document["products"], after["products"]
    assert new == {**old, "orientation_covariance": None}
    assert read_products(FROZEN / "stereo_3.json")[0].orientation is None


def test_a_product_of_the_first_form_means_what_it_meant():
    """Read as values and written again: all numbers of the old document, to the last bit."""
    (old,) = json.loads((FROZEN / "stereo_1.json").read_text())["products"]
    (product,) = read_products(FROZEN / "stereo_1.json")
    assert product.job.seams is None
    assert product.job.balance is None
    assert product.job.options.seams == "nearest"
    again = {
        "photographs": [p.orientation.centre for p in product.job.photographs],
        "law": product.job.law.as_record(),
        "grid": product.job.grid.affine,
    }
    assert again["photographs"] == [tuple(p["centre"]) for p in old["photographs"]]
    assert {k: again["law"][k] for k in old["law"]} == old["law"]
    assert list(again["grid"]) == old["grid"]["affine"]


def test_the_present_form_is_written_as_it_was_read(monkeypatch):
    (written,) = json.loads((FROZEN / "stereo_4.json").read_text())["products"]
    (product,) = read_products(FROZEN / "stereo_4.json")
    assert product.job.seams is not None
    assert product.job.balance is not None
    assert product.job.balance.local
    assert product.orientation is not None
    # The height model itself is not among the frozen files, so nothing can be hashed.
    monkeypatch.setattr(record, "height_model_record", lambda model, folder: written["height_model"])
    again = json.loads(json.dumps(product_record(product)), parse_constant=lambda nan: None)
    assert {key: again[key] for key in written} == written


# --- the ledger -------------------------------------------------------------------------------------------


def test_blobs_of_a_frozen_ledger_are_read(tmp_path):
    ledger = Ledger.open(placed(forms.LEDGER, 1, tmp_path), "k")
    assert ledger.has(0)
    assert ledger.get(0, "ortho") == bytes(range(256))
    assert (ledger.get(0, "mate"), ledger.get(0, "lineage")) == (b"", b"\x00\x01")
