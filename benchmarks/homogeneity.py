"""Homogeneity map of a block: CPU seconds per million positions and object height, and peak memory.

A planned flight (no photographs) over a fractal height model of 2 m: the claim is a map of 10,000 x 10,000 in
under two minutes per object height on two cores, that is 2.4 CPU seconds per million positions.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

# Edge of the map in positions: 2000 for a quick look, 10000 for the claim itself.
EDGE = int(os.environ.get("STEREOMATE_BENCH_EDGE", "2000"))
CLAIM_S_PER_MILLION = 2.4

_SCRIPT = """
import json, resource, sys, time
from dataclasses import replace
from pathlib import Path
from stereomate.coverage.summary import survey_coverage
from stereomate.rectify.options import RectifyOptions
from stereomate.rectify.planning import Request, plan_products
from stereomate.stereo.homogeneity import coarse_job, write_homogeneity
from stereomate.synthetic.options import SurveyOptions
from stereomate.synthetic.survey import make_survey
from stereomate.terrain.model import HeightModel

edge, folder = int(sys.argv[1]), Path(sys.argv[2])
survey = make_survey(SurveyOptions(strips=3, photos_per_strip=6, buildings=0, trees=0, relief_m=150.0))
world = survey.world
heights = HeightModel.from_array(world.heights, world.affine, world.frame)
coverage = survey_coverage(survey.survey, heights)
job = plan_products(survey.survey, heights, coverage, RectifyOptions(gsd=0.3), Request())[0]
write_homogeneity(coarse_job(job, 20.0), folder / "warm.tif", 10.0)
cols, rows = job.grid.size
job = coarse_job(job, job.grid.gsd * (cols * rows) ** 0.5 / edge)
started, cpu = time.perf_counter(), time.process_time()
write_homogeneity(job, folder / "map.tif", 10.0, threads=2)
wall, cpu = time.perf_counter() - started, time.process_time() - cpu
size = job.grid.size[0] * job.grid.size[1]
print(json.dumps({"millions": size / 1e6, "wall": wall, "cpu": cpu,
                  "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}))
"""


def run() -> list[dict[str, Any]]:
    """One row for time, one for memory."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", _SCRIPT, str(EDGE), str(Path(folder))]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = json.loads(said.splitlines()[-1])
    per_million = found["cpu"] / found["millions"]
    note = f"{found['millions']:.1f} million positions in {found['wall']:.0f} s, claim: below the peer column"
    return [
        {
            "name": "homogeneity map",
            "ours": per_million,
            "peer": CLAIM_S_PER_MILLION,
            "ratio": per_million / CLAIM_S_PER_MILLION,
            "unit": "CPU s per million positions",
            "note": note,
        },
        {"name": "homogeneity map, memory", "ours": found["memory"], "unit": "MiB", "note": "peak"},
    ]
