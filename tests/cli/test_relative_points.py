"""`stereomate relative --points`: measured points as users have them, good and bad."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from stereomate.cli.main import run
from stereomate.errors import InputError
from stereomate.geometry.rotations import rotation_from_opk
from stereomate.relative.elements import dependent_elements
from stereomate.relative.measured_orientation import orient_measured
from stereomate.relative.measured_points import correspondences_of_table, photo_coordinates
from stereomate.relative.pair import RelativePose, correspondences_from_photo
from stereomate.relative.point_table import PointTable, read_point_table

C = 153.0
NOISE = 0.005
POSE = RelativePose(
    np.array([1.0, 0.03, -0.02]) / np.linalg.norm([1.0, 0.03, -0.02]), rotation_from_opk([0.02, -0.03, 0.05])
)
MM = "point,x_left,y_left,x_right,y_right"
PX = "point,col_left,row_left,col_right,row_right"


def seen(points, noise=NOISE, seed=0):
    """Photo coordinates (mm) of model points, left and right."""
    rng = np.random.default_rng(seed)
    turned = (points - POSE.base) @ POSE.left_from_right
    sides = (p[:, :2] / -p[:, 2:] * C for p in (points, turned))
    return tuple(side + rng.normal(0.0, noise, side.shape) for side in sides)


def terrain(n=20, seed=5):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-0.1, 1.1, n), rng.uniform(-0.9, 0.9, n), -rng.uniform(1.4, 1.8, n)])


def on_cylinder(n):
    rng = np.random.default_rng(2)
    angle = rng.uniform(-0.6, 0.6, n)
    return np.column_stack(
        [rng.uniform(0.0, 1.0, n), 0.9 * np.sin(2.0 * angle), -0.9 * (1.0 + np.cos(2.0 * angle))]
    )


def with_first_behind(n):
    points = terrain(n)
    points[0, 2] *= -1.0
    return points


def bad_points(kind, n):
    """Left and right photo coordinates of `n` points that do not determine an orientation."""
    flat = terrain(n) * np.array([1.0, 1.0, 0.0]) - np.array([0.0, 0.0, 1.6])
    left, right = seen(terrain(n))
    if kind == "line":
        return seen(flat * np.array([1.0, 0.0, 1.0]) + flat[:, :1] * np.array([0.0, 0.3, 0.0]))
    if kind == "cylinder":
        return seen(on_cylinder(n))
    if kind == "behind":
        return seen(with_first_behind(n))
    if kind == "no overlap":
        return tuple(np.random.default_rng(n).uniform(-100.0, 100.0, (2, n, 2)))
    if kind == "one in pixels":
        return left * 3.0, right
    assert kind == "same photograph"
    return left, left


REASONS = {
    "line": "one line",
    "cylinder": "critical|do not determine the elements",
    "behind": "1 of .* points lie behind a camera",
    "no overlap": "agree on no orientation|one line|do not determine|another orientation|behind a camera",
    "one in pixels": "agree|do not determine|another orientation|behind a camera",
    "same photograph": "no parallax",
}


@pytest.mark.parametrize("n", [6, 8, 11, 15, 40])
@pytest.mark.parametrize("kind", REASONS)
def test_what_points_do_not_determine_is_said(kind, n):
    left, right = bad_points(kind, n)
    result = orient_measured(correspondences_from_photo(left, right, C, NOISE), [str(k) for k in range(n)])
    if kind == "behind" and n >= 12:
        # Enough others outvote it: it is left out, and named.
        assert result.determined
        assert any(note.endswith("left out: 0") for note in result.notes)
        return
    assert not result.determined, result.notes
    assert re.search(REASONS[kind], "; ".join(result.reasons)), result.reasons


@pytest.mark.parametrize("n", [6, 8, 15, 40])
@pytest.mark.parametrize("exchanged", [False, True])
@pytest.mark.parametrize("flat", [False, True])
def test_good_points_give_the_truth_and_remarks(n, exchanged, flat):
    points = terrain(n)
    if flat:
        points[:, 2] = -1.6
    sides = seen(points)
    c = correspondences_from_photo(*(sides[::-1] if exchanged else sides), C, NOISE)
    result = orient_measured(c, [str(k) for k in range(n)])
    truth = POSE
    if exchanged:
        turn = np.array(POSE.left_from_right).T
        truth = RelativePose(-turn @ POSE.base, turn)
    said = " ".join((*result.reasons, *result.notes))
    assert ("plane" in said) == flat
    if not result.determined:
        # A plane has two solutions; few points may leave both.
        assert flat
        assert "another orientation" in said
        return
    deviation = np.sqrt(np.linalg.eigvalsh(result.orientation.adjustment.cofactor)[-1])
    assert max(result.orientation.pose.angles_to(truth)) < 4.0 * deviation
    assert ("exchanged?" in said) == exchanged


def test_other_remarks():
    left, right = seen(terrain(), noise=0.05)
    few = orient_measured(
        correspondences_from_photo(left[:9], right[:9], C, NOISE), [str(k) for k in range(9)]
    )
    assert any("times what a standard deviation of 0.005 mm allows" in note for note in few.notes)
    left, right = seen(terrain(), noise=0.0)
    five = orient_measured(correspondences_from_photo(left[:5], right[:5], C, NOISE), list("abcde"))
    said = " ".join((*five.reasons, *five.notes))
    assert "no redundancy" in said or "satisfy the five points" in said
    nearly = on_cylinder(40) + np.random.default_rng(1).normal(0.0, 0.03, (40, 1)) * np.array([0.0, 0.0, 1.0])
    near = orient_measured(correspondences_from_photo(*seen(nearly), C, NOISE), [str(k) for k in range(40)])
    assert near.determined
    assert any("near a critical cylinder" in note for note in near.notes)


def table_text(left, right, head=MM, names=None, weights=None):
    lines = [head if weights is None else f"{head},weight"]
    for k, row in enumerate(np.hstack([left, right])):
        cells = [names[k] if names else f"p{k}", *(f"{value:.5f}" for value in row)]
        lines.append(",".join(cells if weights is None else [*cells, str(weights[k])]))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "\n".join(text.splitlines()[:5]), "must have five points or more"),
        (lambda text: text + "p20,1,nan,2,3\n", "point p20, y_left: must be a finite number, got 'nan'"),
        (lambda text: text + "p20,inf,1,2,3\n", "point p20, x_left: must be a finite number, got 'inf'"),
        (lambda text: text + text.splitlines()[1] + "\n", "must be names that come once, got 'p0'"),
        (lambda text: text + "q" + text.splitlines()[1] + "\n", "got 'the coordinates of point p0'"),
        (lambda text: text + "p20,4000,-3000,3900,-3000\n", "point p20, left: must be millimetres, within 3"),
        (lambda text: text.replace("x_left", "xl"), "must have the columns point, x_left"),
    ],
)
def test_bad_tables_are_one_line_and_leave_nothing(tmp_path: Path, capsys, change, message):
    file, out = tmp_path / "points.csv", tmp_path / "record.json"
    file.write_text(change(table_text(*seen(terrain()))))
    with pytest.raises(SystemExit) as end:
        run(["relative", "--points", str(file), "--principal-distance", "153", "-o", str(out)])
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["points.csv"]


def test_coordinates_from_a_corner_are_refused():
    left, right = (side + 130.0 for side in seen(terrain()))
    table = read_point_table(table_text(left, right), "t.csv")
    with pytest.raises(InputError, match="counted from the principal point"):
        photo_coordinates(table, Path("t.csv"), (C, C))
    # One quadrant of one photograph only is a small overlap.
    photo_coordinates(
        PointTable("image", table.names, table.values - [130, 130, 300, 130]), Path("t"), (C, C)
    )


def test_weights_act_as_standard_deviations():
    left, right = seen(terrain())
    table = read_point_table(table_text(left, right, weights=[4.0] * 20), "t.csv")
    weighted = correspondences_of_table(table, Path("t.csv"), (C, C), 0.01)
    plain = correspondences_from_photo(*np.hsplit(table.values, 2), C, 0.005)
    one, other = (orient_measured(c, table.names).orientation for c in (weighted, plain))
    np.testing.assert_allclose(one.adjustment.cofactor, other.adjustment.cofactor, rtol=1e-6)
    assert one.sigma0 == pytest.approx(other.sigma0, rel=1e-6)


def test_command(tmp_path: Path, capsys):
    """Millimetres and the same points as pixels of a camera; record, figures, exit codes."""
    left, right = seen(terrain())
    right[3, 1] += 0.3
    (tmp_path / "mm.csv").write_text(table_text(left, right))
    down = np.array([40.0, -40.0])
    (tmp_path / "px.csv").write_text(table_text(left * down + 5000.0, right * down + 5000.0, PX))
    (tmp_path / "cylinder.csv").write_text(table_text(*seen(on_cylinder(20))))
    camera = tmp_path / "camera.toml"
    camera.write_text(
        f'[[camera]]\nname = "c"\nprincipal_distance_mm = {C}\n'
        "size_px = [10000, 10000]\npixel_pitch_mm = 0.025\n"
    )

    def command(*arguments):
        with pytest.raises(SystemExit) as end:
            run(["relative", "--points", *map(str, arguments)])
        return end.value.code, *capsys.readouterr()

    figures = ["--figures", tmp_path / "f", "-o", tmp_path / "r.json"]
    code, text, _ = command(tmp_path / "mm.csv", "--principal-distance", C, *figures)
    assert code == 0
    assert "left out: p3" in text
    assert "minimal detectable (mm)" in text
    assert {path.name for path in (tmp_path / "f").iterdir()} == {"y-parallaxes.png", "six-points.png"}
    record = json.loads((tmp_path / "r.json").read_text())
    truth = dependent_elements(POSE, np.eye(5))
    assert record["dependent"]["omega_deg"] == pytest.approx(np.degrees(truth["omega"]), abs=0.03)
    assert record["points"]["names"][3] == "p3"
    assert abs(record["points"]["y_parallax_mm"][3]) == pytest.approx(0.3, abs=0.05)
    code, text, _ = command(tmp_path / "px.csv", "--camera", camera, "--sigma", 0.2, "--json")
    assert code == 0
    pixels = json.loads(text)
    assert pixels["unit"] == "px"
    assert pixels["sigma0"] == pytest.approx(record["sigma0"], rel=1e-3)
    for key in ("by", "bz", "omega_deg", "phi_deg", "kappa_deg"):
        assert pixels["dependent"][key] == pytest.approx(record["dependent"][key], abs=1e-5)
    code, text, error = command(tmp_path / "cylinder.csv", "--principal-distance", C, "--json")
    assert code == 2
    assert "critical" in error
    assert json.loads(text)["determined"] is False
    for wrong, message in (
        (["mm.csv", "--camera", camera], "--principal-distance"),
        (["px.csv", "--principal-distance", C], "--camera"),
        (["mm.csv"], "--camera or --principal-distance"),
        (["mm.csv", "--principal-distance", "long"], "one number or LEFT,RIGHT"),
        (["mm.csv", "--principal-distance", C, "--sigma", -1], "--sigma"),
        (["none.csv", "--principal-distance", C], "none.csv"),
    ):
        code, _, error = command(tmp_path / wrong[0], *wrong[1:])
        assert code == 2
        assert message in error
        assert error.count("\n") == 1
