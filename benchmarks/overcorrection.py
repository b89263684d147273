"""Over-correction factors of a million cross-sections: this package against plain numpy."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from stereomate.relative.overcorrection import factor_change_per_metre, overcorrection_factor

SECTIONS = 1_000_000
GOAL_S = 0.1
RUNS = 7


def plain_numpy(sections: NDArray[np.float64]) -> NDArray[np.float64]:
    """The formula as one would write it, without checks of the input or of the critical circle."""
    y, z = sections[..., 0], sections[..., 1]
    t = y / z
    k = (y * y + z * z) / z
    t1, t3, t5 = t[..., 0], t[..., 1], t[..., 2]
    k1, k3, k5 = k[..., 0], k[..., 1], k[..., 2]
    factors: NDArray[np.float64] = k5 / ((k5 - k1) - (t5 - t1) * (k3 - k1) / (t3 - t1))
    return factors


def median_seconds(work: Callable[[], object]) -> float:
    work()
    times = []
    for _ in range(RUNS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return statistics.median(times)


def run() -> list[dict[str, object]]:
    """Rows of the benchmark: name, ours, peer, ratio, unit, note."""
    rng = np.random.default_rng(0)
    shape = (SECTIONS, 3)
    sections = np.stack((rng.uniform(-900.0, 900.0, shape), rng.uniform(500.0, 2000.0, shape)), axis=-1)
    difference = np.abs(overcorrection_factor(sections) / plain_numpy(sections) - 1.0).max()
    ours = median_seconds(lambda: overcorrection_factor(sections))
    peer = median_seconds(lambda: plain_numpy(sections))
    slopes = median_seconds(lambda: factor_change_per_metre(sections))
    return [
        {
            "name": "over-correction factors of 1M sections, peer plain numpy",
            "ours": ours,
            "peer": peer,
            "ratio": ours / peer,
            "unit": "s",
            "note": f"goal {GOAL_S} s; largest relative difference {difference:.1e}",
        },
        {
            "name": "their changes per metre of height",
            "ours": slopes,
            "peer": None,
            "ratio": None,
            "unit": "s",
            "note": "",
        },
    ]


def main() -> None:
    for row in run():
        print(row)


if __name__ == "__main__":
    main()
