"""Tables of orientations in any column order, separator and quotes."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stereomate.errors import FormatError, OrientationError
from stereomate.formats.orientation_table import read_orientation_table

VALUES = {"x": 512000.25, "y": 5400000.5, "z": 512.125, "omega": -0.25, "phi": 1.5, "kappa": -179.75}
HEADS = {
    "filename": ["filename", "Image", "PHOTO_ID", "label"],
    "x": ["x", "X", "Easting", "x[m]", "X0"],
    "y": ["y", "northing", "Y (m)"],
    "z": ["z", "Height", "altitude", "Z[m]"],
    "omega": ["omega", "Omega[deg]", "ω", "omega_deg", "OMEGA (deg)"],
    "phi": ["phi", "Phi [deg]", "φ"],
    "kappa": ["kappa", "KAPPA", "κ"],
}


def write(tmp_path, text, name="o.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_text(text, encoding=encoding)
    return path


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    order=st.permutations(["filename", *VALUES, "junk"]),
    separator=st.sampled_from([",", ";", "\t", "|", " ", "   "]),
    quote=st.sampled_from(["", '"', "'"]),
    data=st.data(),
)
def test_any_order_separator_and_quotes(tmp_path, order, separator, quote, data):
    heads = [data.draw(st.sampled_from(HEADS[c])) if c in HEADS else "my notes" for c in order]
    # A separator inside a name needs quotes; blanks separate without them.
    if not quote:
        heads = [head.replace(" ", "") for head in heads]
    name = "strip 1/photo.tif" if quote else "photo.tif"
    cells = [name if c == "filename" else repr(VALUES[c]) if c in VALUES else "text" for c in order]
    lines = [separator.join(f"{quote}{cell}{quote}" for cell in line) for line in (heads, cells)]
    table = read_orientation_table(write(tmp_path, "\n".join(lines)))
    (row,) = table.rows
    assert row.name == name
    assert dict(row.numbers) == VALUES
    assert len(table.ignored) == 1


def test_decimal_comma(tmp_path):
    table = read_orientation_table(write(tmp_path, "name;x;y;z\na;1,5;2,25;-3,0\n"))
    assert table.rows[0].values(("x", "y", "z")) == (1.5, 2.25, -3.0)


def test_comments_bom_and_a_header_behind_a_hash(tmp_path):
    text = (
        "# made by hand\n#Label,X/Easting,Y/Northing,Z/Altitude,Yaw,Pitch,Roll\n\na.jpg,1,2,3,4,5,6\n# end\n"
    )
    table = read_orientation_table(write(tmp_path, text, encoding="utf-8-sig"))
    assert table.columns == ("filename", "x", "y", "z", "yaw", "pitch", "roll")
    assert table.rows[0].values(("roll", "pitch", "yaw")) == (6.0, 5.0, 4.0)


def test_geographic_columns(tmp_path):
    table = read_orientation_table(
        write(tmp_path, "file lat lon alt heading pitch roll\na 47 9 500 90 0 1\n")
    )
    assert table.rows[0].values(("longitude", "latitude", "z")) == (9.0, 47.0, 500.0)
    assert table.rows[0].numbers["yaw"] == 90.0


@pytest.mark.parametrize(
    ("written", "unit"), [("omega[gon]", "gon"), ("omega (rad)", "rad"), ("omega_deg", "deg")]
)
def test_unit_in_the_header(tmp_path, written, unit):
    table = read_orientation_table(write(tmp_path, f"name,x,y,z,{written},phi,kappa\na,1,2,3,4,5,6\n"))
    assert table.angle_unit == unit


def test_columns_are_declared_where_there_is_no_header(tmp_path):
    path = write(tmp_path, "a 1 2 3 9 4 5 6\nb 1 2 3 9 4 5 6\n")
    with pytest.raises(FormatError, match=r"has no header line.*name its 8 columns"):
        read_orientation_table(path)
    columns = ["filename", "x", "y", "z", "other", "omega", "phi", "kappa"]
    table = read_orientation_table(path, columns)
    assert [row.numbers["omega"] for row in table.rows] == [4.0, 4.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no orientation"),
        ("name,x,y,z\n", "header but no orientation"),
        ("name,x,y,z\na,1,2\n", r"line 2: must have 4 columns.*got 3"),
        ("name,x,y,z\na,1,two,3\n", r"line 2, y: must be a number, got 'two'"),
        ("name,x,y,z\na,1,nan,3\n", r"line 2, y: must be a number, got 'nan'"),
        ("name,x,y\na,1,2\n", "must have the columns x, y, z or longitude, latitude, height"),
        ("x,y,z\na,b,c\n", "must have the columns filename"),
        ("name,x,easting,y,z\na,1,2,3,4\n", "has a column twice"),
        ("name,x,y,z,omega[deg],phi[gon],kappa\na,1,2,3,4,5,6\n", "several units of angles"),
    ],
)
def test_malformed_tables(tmp_path, text, message):
    with pytest.raises(FormatError, match=message):
        read_orientation_table(write(tmp_path, text))


def test_not_there_and_no_text(tmp_path):
    with pytest.raises(FormatError, match="does not exist"):
        read_orientation_table(tmp_path / "no.csv")
    path = tmp_path / "o.csv"
    path.write_bytes(b"name,x\n\xe4,1\n")
    with pytest.raises(FormatError, match="UTF-8"):
        read_orientation_table(path)


def test_a_photograph_twice(tmp_path):
    with pytest.raises(OrientationError, match=r"a\.tif: is named twice, in lines 2 and 4"):
        read_orientation_table(write(tmp_path, "name,x,y,z\na.tif,1,2,3\nb.tif,1,2,3\na.tif,4,5,6\n"))


@pytest.mark.real
def test_real_tables(data_folder):
    ngi = read_orientation_table(data_folder / "ngi_strip05" / "ngi_xyz_opk.csv")
    assert ngi.rows[1].numbers["kappa"] == -179.028
    adjusted = read_orientation_table(data_folder / "odm_tuniu" / "odm_xyz_opk.csv")
    assert adjusted.rows[0].camera == "dji fc6310r 5472 3648 brown 0.6666"
    raw = read_orientation_table(data_folder / "odm_tuniu" / "odm_lla_rpy.csv")
    assert raw.rows[0].values(("longitude", "latitude", "z")) == (120.9517016, 24.68027804, 186.57)
    assert raw.ignored == ("other",)
