"""Whole commands timed from outside, in turn, so that a comparison holds when the machine's speed drifts."""

from __future__ import annotations

import os
import statistics
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PEERS = ROOT / ".venv-peers"


@dataclass(frozen=True)
class Usage:
    """What one run of a command took: seconds of wall and CPU, peak memory of the process in MB."""

    wall: float
    cpu: float
    peak_mb: float


def timed(command: Sequence[str], environment: dict[str, str] | None = None) -> Usage:
    """Run a command to its end."""
    start = time.perf_counter()
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env={**os.environ, **(environment or {})}
    )
    assert process.stderr is not None
    errors = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    if status != 0:
        raise RuntimeError(f"{' '.join(command)} failed: {errors.decode()[-2000:]}")
    return Usage(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0)


def timed_in_memory(command: Sequence[str]) -> Usage:
    """As `timed`, with the memory that the process itself ever held (VmHWM of Linux), asked for as it runs.

    What wait4 returns counts the parent's memory too, which the child shares until it is replaced.
    """
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    status = Path(f"/proc/{process.pid}/status")
    peak = 0.0
    while True:
        pid, code, usage = os.wait4(process.pid, os.WNOHANG)
        if pid:
            break
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM"):
                peak = max(peak, int(line.split()[1]) / 1024.0)
        time.sleep(0.1)
    wall = time.perf_counter() - start
    if code != 0:
        raise RuntimeError(f"{' '.join(command)} failed with {os.waitstatus_to_exitcode(code)}")
    return Usage(wall, usage.ru_utime + usage.ru_stime, peak)


def in_turn(commands: Sequence[Callable[[], Usage]], runs: int) -> list[list[Usage]]:
    """Usages of several commands, run A B C A B C ..., after one uncounted run of each."""
    for command in commands:
        command()
    results: list[list[Usage]] = [[] for _ in commands]
    for _ in range(runs):
        for result, command in zip(results, commands, strict=True):
            result.append(command())
    return results


def median(usages: Sequence[Usage], figure: str) -> float:
    """Median of `wall`, `cpu` or `peak_mb`."""
    return statistics.median(getattr(u, figure) for u in usages)


def median_ratio(ours: Sequence[Usage], peer: Sequence[Usage], figure: str) -> float:
    """Median of the ratios run by run."""
    return statistics.median(getattr(a, figure) / getattr(b, figure) for a, b in zip(ours, peer, strict=True))


def peer_command(name: str, package: str) -> str | None:
    """A peer's command in the environment of peers, made on demand; None where it cannot be had."""
    path = PEERS / "bin" / name
    if not path.exists():
        try:
            subprocess.run(["python3", "-m", "venv", str(PEERS)], check=True, capture_output=True)
            pip = [str(PEERS / "bin" / "python"), "-m", "pip", "install", "--quiet", package]
            subprocess.run(pip, check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            return None
    return str(path) if path.exists() else None
