"""Relative orientation from correspondences: time and accuracy beside OpenCV's USAC and poselib.

OpenCV is the one this package itself runs with; poselib runs in a virtual environment of its own
(`.venv-peers`, made with ``python -m venv .venv-peers`` and ``pip install poselib``). Every peer has a
process of its own, one thread, and gets the same correspondences by a file; rows of peers that are not
there, or crash, say so. Times are CPU times of the process: they do not count what else the machine does.
Errors are paired: every seed is solved by both, and compared with least squares over the true inliers.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

SIZES = (1_000, 10_000, 100_000)
OUTLIERS = (0.0, 0.2, 0.5)
REPETITIONS = 5
SEEDS = 200
FOCAL_PX, SIDE_PX, NOISE_PX, THRESHOLD_PX = 1000.0, 1000.0, 0.5, 1.5
PEERS = ("USAC_MAGSAC", "USAC_ACCURATE", "poselib")
PEER_PYTHON = Path(__file__).resolve().parents[1] / ".venv-peers" / "bin" / "python"

# Runs in the peers' environment: reads correspondences, prints milliseconds per repetition.
PEER_CODE = """
import json, sys, time
import numpy as np
name, path, repetitions = sys.argv[1], sys.argv[2], int(sys.argv[3])
data = np.load(path)
left, right, focal, threshold = data["left"], data["right"], float(data["focal"]), float(data["threshold"])
times = []
if name == "poselib":
    import poselib
    camera = {"model": "SIMPLE_PINHOLE", "width": 1000, "height": 1000, "params": [focal, 0.0, 0.0]}
    options = {"max_epipolar_error": threshold, "success_prob": 0.9999}
    def solve():
        return poselib.estimate_relative_pose(left, right, camera, camera, options, {})
else:
    import cv2
    cv2.setNumThreads(1)
    matrix = np.diag([focal, focal, 1.0])
    method = getattr(cv2, name)
    def solve():
        return cv2.findEssentialMat(left, right, matrix, method=method, prob=0.9999, threshold=threshold)
solve()
for _ in range(repetitions):
    start = time.process_time()
    solve()
    times.append(1e3 * (time.process_time() - start))
print(json.dumps(times))
"""


def scene(n: int, outliers: float, seed: int) -> tuple[Any, Any, Any, Any]:
    """Photo coordinates (n, 2) of both photographs in pixels (x right, y up), true pose, true inliers."""
    from stereomate.geometry.rotations import rotation_from_opk
    from stereomate.relative.pair import RelativePose

    rng = np.random.default_rng(seed)
    base = np.array([1.0, *rng.normal(0.0, 0.05, 2)])
    pose = RelativePose(base / np.linalg.norm(base), rotation_from_opk(rng.normal(0.0, 0.05, 3)))
    half = SIDE_PX / 2.0
    found: list[Any] = []
    while sum(len(pair[0]) for pair in found) < n:
        left = rng.uniform(-half, half, (2 * n, 2)) / FOCAL_PX
        points = np.column_stack([left, -np.ones(2 * n)]) * rng.uniform(2.0, 3.0, (2 * n, 1))
        seen = (points - pose.base) @ pose.left_from_right
        right = seen[:, :2] / -seen[:, 2:]
        inside = (np.abs(right) < half / FOCAL_PX).all(axis=1)
        found.append((left[inside], right[inside]))
    left, right = (np.concatenate([pair[k] for pair in found])[:n] * FOCAL_PX for k in range(2))
    left, right = (side + rng.normal(0.0, NOISE_PX, side.shape) for side in (left, right))
    bad = rng.permutation(n)[: int(n * outliers)]
    left[bad] = rng.uniform(-half, half, (len(bad), 2))
    right[bad] = rng.uniform(-half, half, (len(bad), 2))
    good = np.ones(n, dtype=np.bool_)
    good[bad] = False
    return left, right, pose, good


def run() -> list[dict[str, Any]]:
    """Rows of times for the whole grid, and of accuracy."""
    rows = []
    for n in SIZES:
        for outliers in OUTLIERS:
            rows += _time_rows(n, outliers)
    for n in SIZES:
        for outliers in OUTLIERS:
            rows.append(_accuracy_row(n, outliers, SEEDS))
    return rows


def _ours(left: Any, right: Any) -> Any:
    from stereomate.relative.coplanarity import adjust_coplanarity
    from stereomate.relative.pair import correspondences_from_photo
    from stereomate.relative.robust import robust_orientation

    c = correspondences_from_photo(left, right, FOCAL_PX, NOISE_PX)
    found = robust_orientation(c)
    assert found.pose is not None
    return adjust_coplanarity(c, found.pose, use=found.inliers)


def _whole(left: Any, right: Any) -> Any:
    from stereomate.relative.orientation import relative_orientation
    from stereomate.relative.pair import correspondences_from_photo

    return relative_orientation(correspondences_from_photo(left, right, FOCAL_PX, NOISE_PX))


def _milliseconds(solve: Any, left: Any, right: Any, repetitions: int) -> list[float]:
    solve(left, right)
    times = []
    for _ in range(repetitions):
        start = time.process_time()
        solve(left, right)
        times.append(1e3 * (time.process_time() - start))
    return times


def _time_rows(n: int, outliers: float) -> list[dict[str, Any]]:
    left, right, _, _ = scene(n, outliers, 1)
    repetitions = max(REPETITIONS, 20_000 // n)
    name = f"{n} points, {100 * outliers:.0f} % wrong"
    peers: dict[str, list[float]] = {peer: [] for peer in PEERS}
    ours: list[float] = []
    whole: list[float] = []
    # In turns, so that all see the same load of the machine.
    for _ in range(3):
        ours += _milliseconds(_ours, left, right, repetitions)
        whole += _milliseconds(_whole, left, right, repetitions)
        for peer in PEERS:
            peers[peer] += _peer_times(peer, left, right, 1 if n > 50_000 else max(2, repetitions // 3))
    own, complete = statistics.median(ours), statistics.median(whole)
    rows = []
    measured = {peer: statistics.median(times) for peer, times in peers.items() if times}
    for peer in PEERS:
        theirs = measured.get(peer)
        rows.append(
            {
                "name": f"{name}: pose and covariance against {peer}",
                "ours": own,
                "peer": theirs,
                "ratio": None if theirs is None else own / theirs,
                "unit": "ms",
                "note": "CPU time" if theirs is not None else "peer not installed or crashed",
            }
        )
    if measured:
        fastest = min(measured, key=lambda peer: measured[peer])
        rows.append(
            {
                "name": f"{name}: with all statistics and diagnosis against the fastest",
                "ours": complete,
                "peer": measured[fastest],
                "ratio": complete / measured[fastest],
                "unit": "ms",
                "note": fastest,
            }
        )
    return rows


def _peer_times(peer: str, left: Any, right: Any, repetitions: int) -> list[float]:
    python = PEER_PYTHON if peer == "poselib" else Path(sys.executable)
    if not python.is_file():
        return []
    down = np.array([1.0, -1.0])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pair.npz"
        np.savez(path, left=left * down, right=right * down, focal=FOCAL_PX, threshold=THRESHOLD_PX)
        done = subprocess.run(
            [str(python), "-c", PEER_CODE, peer, str(path), str(repetitions)],
            capture_output=True,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            check=False,
        )
    # A crash (USAC_ACCURATE dies without outliers at 100k) is reported as a missing figure.
    if done.returncode != 0:
        return []
    return [float(value) for value in json.loads(done.stdout)]


def _accuracy_row(n: int, outliers: float, seeds: int) -> dict[str, Any]:
    from stereomate.relative.coplanarity import adjust_coplanarity
    from stereomate.relative.pair import correspondences_from_photo

    ours, best = [], []
    for seed in range(seeds):
        left, right, pose, good = scene(n, outliers, seed)
        ours.append(_ours(left, right).pose.angles_to(pose))
        c = correspondences_from_photo(left, right, FOCAL_PX, NOISE_PX)
        best.append(adjust_coplanarity(c, pose, use=good).pose.angles_to(pose))
    mean, optimum = np.degrees(np.mean(ours, axis=0)), np.degrees(np.mean(best, axis=0))
    ratio = mean / optimum
    return {
        "name": f"{n} points, {100 * outliers:.0f} % wrong: mean error, {seeds} seeds, against the optimum",
        "ours": float(mean.max()),
        "peer": float(optimum.max()),
        "ratio": float(ratio.max()),
        "unit": "deg",
        "note": f"rotation {ratio[0]:.3f}, base {ratio[1]:.3f} times the optimum",
    }


def main() -> None:
    """Print the rows."""
    for row in run():
        print(row)


if __name__ == "__main__":
    main()
