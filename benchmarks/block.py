"""Bundle adjustment against pycolmap's: same observations, start and optimum, CPU seconds of one thread.

Both free the principal distance, the principal point, k1 and k2 of one camera for all photographs, from image
points alone (their cost does not depend on the datum); ours is timed with positions of the photographs (5 cm)
too. pycolmap is run with each of its solvers that suits the size, and its best one counts.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from typing import Any

import numpy as np

SIZES = (25, 100, 400, 1600)
LARGE = 5000


def make_network(count: int, per_photo: int = 60, seed: int = 1) -> Any:
    """A block of `count` photographs in strips, 70 % forward and 60 % side overlap, with noise."""
    from stereomate.block.network import (
        BlockCamera,
        ImagePoints,
        Network,
        Photographs,
        Points,
        Positions,
    )
    from stereomate.camera.distortion import BrownDistortion
    from stereomate.camera.model import Camera
    from stereomate.geometry.rotations import rotation_from_opk, rotation_from_vector

    rng = np.random.default_rng(seed)
    lens = BrownDistortion(k1=-0.02, k2=0.01)
    camera = Camera.from_pixel_pitch("camera", (6000, 4000), 24.0, 0.004, (0.0, 0.0), lens)
    strips = max(1, round(math.sqrt(count)))
    line = count // strips
    width, length = 100.0, 66.7
    i, j = np.meshgrid(np.arange(line), np.arange(strips))
    centres = np.stack(
        [j.ravel() * 0.4 * width, i.ravel() * 0.3 * length, np.full(line * strips, 100.0)], axis=1
    )
    centres = centres + rng.normal(0, 1, centres.shape)
    n = len(centres)
    rotations = rotation_from_opk(rng.normal(0, 0.03, (n, 3)))
    margin = np.array([50.0, 34.0, 0.0])
    low, high = centres.min(axis=0) - margin, centres.max(axis=0) + margin
    area = (high[0] - low[0]) * (high[1] - low[1])
    total = int(per_photo * area / (width * length))
    points = np.column_stack(
        [rng.uniform(low[0], high[0], total), rng.uniform(low[1], high[1], total), rng.normal(0, 5, total)]
    )
    order = np.argsort(points[:, 0])
    points = points[order]
    photo, point, xy = [], [], []
    for k in range(n):
        first, last = np.searchsorted(points[:, 0], [centres[k, 0] - 70, centres[k, 0] + 70])
        near = np.arange(first, last)
        near = near[np.abs(points[near, 1] - centres[k, 1]) < 50]
        pixels, inside = camera.image_from_camera((points[near] - centres[k]) @ rotations[k])
        photo.append(np.full(int(inside.sum()), k))
        point.append(near[inside])
        xy.append(pixels[inside])
    photos, numbers, pixels = np.concatenate(photo), np.concatenate(point), np.concatenate(xy)
    keep = np.bincount(numbers, minlength=total) >= 2
    new = np.cumsum(keep) - 1
    rows = keep[numbers]
    photos, numbers, pixels, points = photos[rows], new[numbers[rows]], pixels[rows], points[keep]
    pixels = pixels + 0.5 * rng.normal(size=pixels.shape)
    names = ("principal_distance_mm", "principal_point_x_mm", "principal_point_y_mm", "k1", "k2")
    return Network(
        (BlockCamera(camera, dict.fromkeys(names, math.inf)),),
        Photographs(
            tuple(f"{k:05d}" for k in range(n)),
            np.zeros(n, np.int64),
            centres + 0.3 * rng.normal(size=centres.shape),
            rotation_from_vector(0.003 * rng.normal(size=(n, 3))) @ rotations,
        ),
        Points(tuple(map(str, range(len(points)))), points + 0.3 * rng.normal(size=points.shape)),
        ImagePoints(photos, numbers, pixels, 0.5),
        None,
        Positions(np.arange(n), centres + 0.05 * rng.normal(size=centres.shape), 0.05),
    )


def ours(count: int) -> dict[str, float]:
    """CPU seconds of the adjustment and of its statistics, peak memory added (MB), cost."""
    import resource
    import time
    from dataclasses import replace

    from stereomate.block.loop import run_loop
    from stereomate.block.options import BlockOptions
    from stereomate.block.statistics import statistics_of

    options = BlockOptions(relative_tolerance=1e-8)
    small = make_network(9)
    run_loop(replace(small, positions=None), options)  # compiles, or loads what is compiled
    statistics_of(run_loop(small, options), options)
    network = make_network(count)
    free = replace(network, positions=None)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    times: dict[str, list[float]] = {"seconds": [], "with positions": [], "statistics": []}
    for _ in range(5 if count <= 400 else 1):
        start = time.process_time()
        solution = run_loop(free, options)
        times["seconds"].append(time.process_time() - start)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    cost, iterations = final_cost(solution), solution.iterations
    for _ in range(3 if count <= 400 else 1):
        start = time.process_time()
        solution = run_loop(network, options)
        times["with positions"].append(time.process_time() - start)
        start = time.process_time()
        statistics_of(solution, options)
        times["statistics"].append(time.process_time() - start)
    return {
        **{name: min(values) for name, values in times.items()},
        "memory": memory / 1024.0,
        "cost": cost,
        "iterations": iterations,
        "observations": len(network.image.photo),
    }


def final_cost(solution: Any) -> float:
    """Weighted sum of squares of the image points at the end."""
    from stereomate.block.loop import image_residuals

    residual = image_residuals(solution.prepared, solution.state)
    return float(np.sum((residual / 0.5) ** 2))


def peer(count: int) -> dict[str, float]:
    """pycolmap on the same image points: the best of its solvers, in the gauge of two cameras."""
    import resource
    import time

    import pycolmap

    network = make_network(count)
    best: dict[str, float] = {}
    for solver in ("DENSE_SCHUR", "SPARSE_SCHUR") if count <= 400 else ("SPARSE_SCHUR",):
        for _ in range(3 if count <= 100 else 1):
            reconstruction = _reconstruction(pycolmap, network)
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            config = pycolmap.BundleAdjustmentConfig()
            for image in reconstruction.images:
                config.add_image(image)
            config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
            options = pycolmap.BundleAdjustmentOptions()
            options.refine_principal_point = True
            options.print_summary = False
            options.ceres.auto_select_solver_type = False
            ceres = options.ceres.solver_options
            ceres.linear_solver_type = getattr(type(ceres.linear_solver_type), solver)
            ceres.num_threads = 1
            ceres.function_tolerance, ceres.gradient_tolerance, ceres.parameter_tolerance = 1e-7, 0.0, 0.0
            start = time.process_time()
            adjuster = pycolmap.create_default_bundle_adjuster(options, config, reconstruction)
            adjuster.solve()
            seconds = time.process_time() - start
            memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0
            if not best or seconds < best["seconds"]:
                cost = _peer_cost(network, reconstruction)
                best = {"seconds": seconds, "memory": memory, "cost": cost, "dense": float(solver[0] == "D")}
    return best


def _reconstruction(pycolmap: Any, network: Any) -> Any:
    """The network's start as pycolmap's value; its camera frame has y down and z forward."""
    camera = network.cameras[0].camera
    columns, rows = camera.size_px
    matrix = np.array(camera.pixel_from_photo)
    focal = camera.principal_distance_mm * matrix[0, 0]
    k1, k2 = camera.distortion.k1, camera.distortion.k2
    reconstruction = pycolmap.Reconstruction()
    reconstruction.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=1,
            model="RADIAL",
            width=columns,
            height=rows,
            params=[focal, columns / 2, rows / 2, k1, k2],
        )
    )
    turn = np.diag([1.0, -1.0, -1.0])
    order = np.argsort(network.image.photo, kind="stable")
    starts = np.searchsorted(network.image.photo[order], np.arange(len(network.photographs.names) + 1))
    place = np.empty(len(order), np.int64)
    for k, name in enumerate(network.photographs.names):
        mine = order[starts[k] : starts[k + 1]]
        place[mine] = np.arange(len(mine))
        marks = pycolmap.Point2DList([pycolmap.Point2D(network.image.xy[row]) for row in mine])
        rotation = turn @ network.photographs.rotations[k].T
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ network.photographs.centres[k])
        image = pycolmap.Image(name=name, points2D=marks, camera_id=1, image_id=k + 1)
        reconstruction.add_image_with_trivial_frame(image, pose)
    order = np.argsort(network.image.point, kind="stable")
    starts = np.searchsorted(network.image.point[order], np.arange(len(network.points.xyz) + 1))
    for j, xyz in enumerate(network.points.xyz):
        mine = order[starts[j] : starts[j + 1]]
        elements = [pycolmap.TrackElement(int(network.image.photo[r]) + 1, int(place[r])) for r in mine]
        reconstruction.add_point3D(xyz, pycolmap.Track(elements))
    return reconstruction


def _peer_cost(network: Any, reconstruction: Any) -> float:
    """Weighted sum of squares of pycolmap's result."""
    total = 0.0
    for image in reconstruction.images.values():
        marks = [mark for mark in image.points2D if mark.has_point3D()]
        xyz = np.array([reconstruction.points3D[mark.point3D_id].xyz for mark in marks])
        pose = image.cam_from_world()
        local = xyz @ pose.rotation.matrix().T + pose.translation
        pixels = np.array([image.camera.img_from_cam(point) for point in local])
        total += float(np.sum((np.array([mark.xy for mark in marks]) - pixels) ** 2))
    return total / 0.25


def run(sizes: tuple[int, ...] = SIZES) -> list[dict[str, object]]:
    """Rows of the table: one for the adjustment and one for the statistics of each size."""
    rows: list[dict[str, object]] = []
    for count in sizes:
        mine, theirs = _apart("ours", count), _apart("peer", count)
        note = f"{mine['observations']:.0f} image points, {mine['iterations']:.0f} iterations"
        if "cost" in theirs:
            note += f", cost {mine['cost']:.6g} / {theirs['cost']:.6g}"
            note += f", memory {mine['memory']:.0f} / {theirs['memory']:.0f} MB"
        ratio = mine["seconds"] / theirs["seconds"] if "seconds" in theirs else None
        rows.append(
            {
                "name": f"adjust {count} photographs",
                "ours": mine["seconds"],
                "peer": theirs.get("seconds"),
                "ratio": ratio,
                "unit": "CPU s",
                "note": note,
            }
        )
        rows.append(
            {
                "name": f"statistics {count} photographs",
                "ours": mine["statistics"],
                "peer": mine["with positions"],
                "ratio": mine["statistics"] / mine["with positions"],
                "unit": "CPU s",
                "note": "against the adjustment itself, with positions; 6x6, 3x3, redundancy numbers",
            }
        )
    return rows


def _apart(what: str, count: int) -> dict[str, float]:
    """One measurement in a process of its own, BLAS on one thread."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.block", what, str(count)],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    if done.returncode:
        print(done.stderr[-2000:], file=sys.stderr)
        return {}
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    print(json.dumps((ours if sys.argv[1] == "ours" else peer)(int(sys.argv[2]))))
