"""`stereomate orient` with strips: shifts and drifts as unknowns, shifts found or not to be seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from measured_block import MeasuredBlock, measured_block

from stereomate.coverage.strips import flight_strips
from stereomate.errors import ProjectError
from stereomate.project.orient import orient
from stereomate.project.orient_report import write_orient_report
from stereomate.project.orient_strips_record import strip_findings

SIGMA = "position_sigma_m = [0.05, 0.05, 0.05]\n"


@pytest.fixture(scope="module")
def two() -> MeasuredBlock:
    return measured_block()


@pytest.fixture(scope="module")
def four() -> MeasuredBlock:
    return measured_block(strips=4, per_strip=4, points=260, seed=3)


def oriented(
    block: MeasuredBlock, folder: Path, shift: tuple[float, float, float], strip: int, orient_keys: str = ""
) -> dict[str, Any]:
    """Oriented with the positions of one strip shifted."""
    positions = block.centres + np.random.default_rng(1).normal(0.0, 0.05, block.centres.shape)
    of = np.array([int(name[1]) for name in block.names])
    positions[of == strip] += shift
    path = block.write(folder, positions=positions, orient=SIGMA + orient_keys)
    return orient(path, folder / "out", documents=lambda r: [write_orient_report(r)]).record


def standardized(block: MeasuredBlock, record: dict[str, Any]) -> np.ndarray:
    order = [block.names.index(entry["name"]) for entry in record["photographs"]]
    found = np.array([entry["position"] for entry in record["photographs"]])
    sigma = np.array([entry["standard_deviation_m"] for entry in record["photographs"]])
    return (found - block.centres[order]) / sigma


@pytest.mark.slow
def test_a_weak_block_says_which_shift_it_could_not_have_seen(two: MeasuredBlock, tmp_path: Path) -> None:
    """Two strips without control: a metre of height of one of them turns the block a little, no more."""
    record = oriented(two, tmp_path, (0.0, 0.0, 1.0), 1)
    first, second, _, every = record["navigation"]["shift_tests"]
    assert not first["significant"]
    assert not second["significant"]
    assert 1.5 < first["detectable_m"][2] < 4.0
    assert every["detectable_m"] == [None, None, None]
    (line,) = [f for f in record["findings"] if "would be seen only from" in f]
    assert f"strip 2 {', '.join(f'{v:.2f}' for v in second['detectable_m'])}" in line
    assert "not at all" not in line
    # Of strips that nothing else holds, no size in metres: it would be larger than the flying height.
    record["navigation"]["shift_tests"][0]["detectable_m"] = [1.25, 935.4, None]
    record["navigation"]["shift_tests"][1]["detectable_m"] = [700.0, 935.4, None]
    (line,) = strip_findings(record["navigation"], [0.05, 0.05, 0.05])
    assert "strip 1 1.25, not at all, not at all; strip 2 not at all; not at all: not even 100" in line
    page = (tmp_path / "out" / "orient.html").read_text(encoding="utf-8")
    assert "least that is seen" in page
    rows = {row["name"]: row["detectable_m"] for row in record["positions"]["residuals"]}
    table = pyarrow.parquet.read_table(tmp_path / "out" / "observations.parquet").to_pydict()
    for name, axis, value in zip(table["of"], table["axis"], table["detectable"], strict=True):
        assert rows[name]["xyz".index(axis)] == pytest.approx(value, rel=1e-9)
    assert "".join(f"<td>{v:.3f}</td>" for v in rows["s1_0"]) in page


@pytest.mark.slow
def test_two_strips_that_contradict_each_other_are_both_in_doubt(two: MeasuredBlock, tmp_path: Path) -> None:
    """Three metres along the flight: the one strip, the other, or the camera: they fly there and back."""
    record = oriented(two, tmp_path, (3.0, 0.0, 0.0), 1)
    (line,) = [f for f in record["findings"] if "contradict each other" in f]
    assert "strips 1, 2" in line
    assert "nothing in the block tells which of them is shifted" in line
    # Half the way between both, and no better than that says.
    assert np.abs(standardized(two, record)).max() < 4.0
    assert 0.5 < record["photographs"][0]["standard_deviation_m"][0] < 4.0


@pytest.mark.slow
def test_a_shifted_strip_is_found_named_and_taken_out_of_the_datum(
    four: MeasuredBlock, tmp_path: Path
) -> None:
    record = oriented(four, tmp_path, (0.0, 0.0, 1.0), 1)
    (taken,) = record["navigation"]["taken_as_shifted"]
    assert taken["strip"] == "2"
    assert taken["shift_m"][2] == pytest.approx(1.0, abs=4.0 * taken["standard_deviation_m"][2])
    assert "positions of strip 2 (s1_0 to s1_3) are shifted as a whole" in record["findings"][0]
    assert not [error for error in record["gross_errors"] if error["kind"] == "positions"]
    assert np.abs(standardized(four, record)).max() < 4.5
    (unknown,) = record["navigation"]["unknowns"]
    assert (unknown["what"], unknown["significant"]) == ("strip 2: shift", True)


@pytest.mark.slow
def test_shifts_and_drifts_with_priors_and_misalignment_are_found_beside_each_other(
    four: MeasuredBlock, tmp_path: Path
) -> None:
    keys = """strips = { north = ["s2_*", "s3_*"], south = ["s0_*", "s1_?"] }
strip_shift_sigma_m = [1.0, 1.0, 1.0]
strip_drift_sigma_m = [0.05, 0.05, 0.05]
attitude_sigma_deg = [0.01, 0.01, 0.02]
boresight_sigma_deg = 0.1
"""
    record = oriented(four, tmp_path, (0.4, 0.0, 0.0), 1, keys)
    navigation = record["navigation"]
    assert [entry["name"] for entry in navigation["strips"]] == ["north", "south"]
    unknowns = {entry["what"]: entry for entry in navigation["unknowns"]}
    assert set(unknowns) == {
        "strip north: shift", "strip south: shift", "strip north: drift", "strip south: drift", "boresight",
    }  # fmt: skip
    assert unknowns["strip north: drift"]["unit"] == "m/photograph"
    assert unknowns["strip north: drift"]["prior"] == [0.05, 0.05, 0.05]
    assert unknowns["boresight"]["prior"] == pytest.approx([np.radians(0.1)] * 3)
    # A shift of both strips is one of the block.
    others = {o["other"] for o in unknowns["strip north: shift"]["not_separable_from"]}
    assert "X0 of photographs" in others
    assert "strip north: shift" in (tmp_path / "out" / "orient.html").read_text(encoding="utf-8")


def test_free_shifts_without_control_leave_the_place_open_and_it_is_said(
    two: MeasuredBlock, tmp_path: Path
) -> None:
    record = oriented(two, tmp_path, (0.0, 0.0, 0.3), 1, 'strip_shift_sigma_m = "free"\n')
    assert record["navigation"]["datum_open"] == ["shift x", "shift y", "shift z"]
    assert record["summary"]["oriented"] == 8
    assert any("the shifts of 2 strips have no prior" in line for line in record["findings"])


def test_every_observation_is_in_a_table_and_the_whole_covariance_on_request(
    two: MeasuredBlock, tmp_path: Path
) -> None:
    """Control, check points, positions, attitudes, priors: residual to influence; asked and found."""
    seen = np.bincount([row[0] for row in two.image], minlength=len(two.ground))
    chosen = np.flatnonzero(seen >= 4)[:9].tolist()
    rng = np.random.default_rng(9001)
    rows, marks = ["name,x,y,z,role"], ["point,photograph,col,row,sigma"]
    for k in chosen:
        x, y, z = two.ground[k] + rng.normal(0.0, 0.02, 3)
        rows.append(f"g{k},{x:.3f},{y:.3f},{z:.3f},{'check' if k in chosen[5:] else 'control'}")
    for point, photo, col, row in two.image:
        if point in chosen:
            dx, dy = rng.normal(0.0, 0.2, 2)
            marks.append(f"g{point},{two.names[photo]},{col + dx:.3f},{row + dy:.3f},0.2")
    (tmp_path / "gcp.csv").write_text("\n".join(rows), encoding="utf-8")
    (tmp_path / "marks.csv").write_text("\n".join(marks), encoding="utf-8")
    more = """[control]
file = "gcp.csv"
measurements = "marks.csv"
sigma_m = [0.02, 0.02, 0.02]

[accuracy]
horizontal_m = 0.1
vertical_m = 0.001
"""
    positions = two.centres + rng.normal(0.0, 0.05, two.centres.shape)
    keys = (
        SIGMA
        + "attitude_sigma_deg = [0.01, 0.01, 0.02]\nboresight_sigma_deg = 0.05\nfull_covariance = true\n"
    )
    path = two.write(tmp_path, positions=positions, orient=keys, more=more)
    result = orient(path, tmp_path / "out", documents=lambda r: [write_orient_report(r)])
    assert result.adjusted is not None
    adjusted = result.adjusted.result
    assert adjusted.statistics is not None
    table = pyarrow.parquet.read_table(tmp_path / "out" / "observations.parquet")
    listed = {name: np.array(column) for name, column in table.to_pydict().items()}
    kinds, counts = np.unique(listed["kind"], return_counts=True)
    assert dict(zip(kinds.tolist(), counts.tolist(), strict=True)) == {
        "attitude": 24, "check": 12, "control": 15, "position": 24, "prior": 3,
    }  # fmt: skip
    used = listed["used"].astype(bool)
    assert used.sum() == 66
    total = listed["redundancy"][used].astype(float).sum() + np.nansum(adjusted.statistics.image.redundancy)
    assert total == pytest.approx(adjusted.redundancy, abs=1e-5)
    for name in ("detectable", "own_shift", "standardized"):
        assert np.isfinite(listed[name][used].astype(float)).all(), name
    # What is detected of it moves its own point less than itself.
    metric = used & (listed["unit"] == "m")
    assert (
        listed["own_shift"][metric].astype(float) < 1.5 * listed["detectable"][metric].astype(float)
    ).all()
    whole = pyarrow.parquet.read_table(tmp_path / "out" / "full_covariance.parquet").to_pydict()
    names = whole.pop("unknown")
    matrix = np.array(list(whole.values()))
    assert list(whole) == names
    sigma = np.concatenate([adjusted.statistics.photo_sigma.ravel(), adjusted.statistics.shared_sigma])
    np.testing.assert_allclose(np.sqrt(np.diag(matrix)), sigma, rtol=1e-6)
    points = pyarrow.parquet.read_table(tmp_path / "out" / "points.parquet").to_pydict()
    block = adjusted.statistics.cofactors.points[0] * adjusted.statistics.scale**2
    assert (points["cxy"][0], points["cxz"][0]) == pytest.approx((block[0, 1], block[0, 2]), rel=1e-9)
    judged = {entry["what"]: entry for entry in result.record["accuracy"]}
    assert judged["horizontal"]["met"]
    assert judged["vertical"]["met"] is False
    page = (tmp_path / "out" / "orient.html").read_text(encoding="utf-8")
    assert "Asked: vertical 0.001 m" in page
    assert "NOT met" in page
    control = result.record["control"]["control"]["points"][0]
    own = [listed["detectable"][k] for k, name in enumerate(listed["of"]) if name == control["name"]]
    assert control["detectable_m"] == pytest.approx(own, rel=1e-9)
    assert "".join(f"<td>{v:.3f}</td>" for v in (*control["sigma_m"], *control["detectable_m"])) in page
    (boresight,) = [
        entry for entry in result.record["navigation"]["unknowns"] if entry["what"] == "boresight"
    ]
    assert boresight["significant"] is False


def test_groups_that_name_nothing_or_a_photograph_twice_are_refused(
    two: MeasuredBlock, tmp_path: Path
) -> None:
    for groups, rule in (
        ('{ a = ["x*"] }', r"orient\.strips\.a: must name photographs of the project"),
        ('{ a = ["s0_*"], b = ["s0_1"] }', r"orient\.strips\.b: must not name a photograph of a too"),
    ):
        path = two.write(tmp_path, positions=two.centres, orient=f"strips = {groups}\n")
        with pytest.raises(ProjectError, match=rule):
            orient(path, tmp_path / "out")
    path = two.write(tmp_path, positions=two.centres, orient="lever_arm_m = { other = [0, 0, 1] }\n")
    with pytest.raises(ProjectError, match=r"orient\.lever_arm_m: must state the lever arm of each mount"):
        orient(path, tmp_path / "out")


def test_strips_follow_the_turns_of_the_flight() -> None:
    """There and back along y, a turn with one photograph of its own, then across; names in their numbers."""
    there = [(0.0, 100.0 * k) for k in range(12)]
    back = [(300.0, 1100.0 - 100.0 * k) for k in range(12)]
    across = [(420.0 + 100.0 * k, -150.0) for k in range(4)]
    plan = np.array(there + back + across)
    names = [f"img_{k}" for k in range(len(plan))]
    shuffled = np.random.default_rng(0).permutation(len(plan))
    strips = flight_strips([names[k] for k in shuffled], np.column_stack([plan, 0 * plan[:, :1]])[shuffled])
    found = np.empty(len(plan), int)
    found[shuffled] = strips
    np.testing.assert_array_equal(found, np.repeat([0, 1, 2], [12, 12, 4]))
    # Times go before names; photographs without a place belong to none.
    times = np.arange(len(plan), dtype=float)
    rigged = flight_strips([f"z{k % 3}_{k}" for k in range(len(plan))], plan, times)
    np.testing.assert_array_equal(rigged, found)
    plan[3] = np.nan
    assert flight_strips(names, plan)[3] == -1
