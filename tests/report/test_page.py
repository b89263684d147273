import re

from stereomate.forms import RUN_PAGE
from stereomate.report.page import Picture, ReportContent, Section, Table, report_html


def content(**changes):
    table = Table(("a", "b"), (("1", "<2>"),), "numbers")
    picture = Picture("data:image/png;base64,AAAA", "what it shows", "alt text", table)
    given = {
        "title": "Block & Sons",
        "subtitle": "Orthophoto",
        "facts": [("GSD", "0.1 m")],
        "sections": [Section("Part", ("text",), (table,), (picture,), ("item",))],
        "footer": "made by",
        "meta": {"software": "stereomate 0"},
    }
    return ReportContent(**(given | changes))


def test_the_page_is_self_contained_and_escaped():
    page = report_html(content())
    assert "Block &amp; Sons" in page
    assert "&lt;2&gt;" in page
    assert f'name="stereomate-report-format" content="{RUN_PAGE.version}"' in page
    # Nothing is fetched: every source is embedded, no links to other hosts, no scripts.
    assert all(source.startswith("data:") for source in re.findall(r'src="([^"]*)"', page))
    assert "http" not in page
    assert "<script" not in page


def test_every_picture_has_an_alternative_text_and_its_numbers():
    page = report_html(content())
    assert 'alt="alt text"' in page
    assert "<details>" in page
