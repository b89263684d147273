"""``python -m benchmarks [NAME ...]``: all benchmarks, or those named, as one table and as JSON."""

from __future__ import annotations

import importlib
import json
import pkgutil
import sys
from pathlib import Path

import benchmarks

COLUMNS = ("name", "ours", "peer", "ratio", "unit", "note")


def main(names: list[str]) -> None:
    """Run the modules of this folder that have a `run`."""
    found = [m.name for m in pkgutil.iter_modules(benchmarks.__path__) if not m.name.startswith("_")]
    rows = []
    for name in names or found:
        module = importlib.import_module(f"benchmarks.{name}")
        if not hasattr(module, "run"):
            continue
        print(f"## {name}", flush=True)
        for row in module.run():
            rows.append({"benchmark": name, **row})
            print(" | ".join(_text(row.get(column)) for column in COLUMNS), flush=True)
    out = Path("bench-results")
    out.mkdir(exist_ok=True)
    (out / "results.json").write_text(json.dumps(rows, indent=1, default=float))


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value if value is not None else "")


if __name__ == "__main__":
    main(sys.argv[1:])
