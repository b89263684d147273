"""Progress bars of long work: rich on a terminal, silent with -q and with --json."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stereomate.cli.settings import Settings

ProgressSink = Callable[[str, int, int], None]


@contextmanager
def progress_of(settings: Settings, as_json: bool = False) -> Iterator[ProgressSink]:
    """A function (stage, done, total) that shows how far the work is, on stderr."""
    if settings.verbosity < 0 or as_json:
        yield lambda stage, done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<16}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, object] = {}

        def show(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)  # type: ignore[arg-type]

        yield show
