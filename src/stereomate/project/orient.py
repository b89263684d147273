"""`stereomate orient`: from raw photographs to an oriented block, with the accuracy of everything stated.

Stages: features, pairs, tie points, start, refinement, adjustment, documents. Measurements are kept in a
database inside the output folder as they are made; a run that was killed goes on from there and gives the
same bytes. The database stays: other programs read it, and a changed project is oriented quickly.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from stereomate import __version__
from stereomate.errors import NotDeterminedError
from stereomate.project.inputs import file_digest
from stereomate.project.orient_adjust import Adjusted, adjust_measured
from stereomate.project.orient_files import ADJUSTMENT, ORIENTED, write_record, write_results
from stereomate.project.orient_inputs import OrientInputs, read_orient_inputs
from stereomate.project.orient_measure import Measured, measure_block
from stereomate.project.orient_record import OrientedPhotos, adjustment_record, oriented_photos
from stereomate.raster.files import storing
from stereomate.tiles.executor import executor_of
from stereomate.tiles.ledger import run_key

LOG = logging.getLogger(__name__)
ProgressSink = Callable[[str, int, int], None]

DATABASE: Final = "measurements.db"


@dataclass(frozen=True)
class OrientOptions:
    """How to orient, besides what the project says.

    Attributes
    ----------
    threads : int
    fresh : bool
        Forget what an earlier run left.
    """

    threads: int = 1
    fresh: bool = False


@dataclass(frozen=True, eq=False)
class OrientResult:
    """An oriented block.

    Attributes
    ----------
    out : Path
    inputs : OrientInputs
    record : dict
        What `adjustment.json` holds.
    measured, adjusted, photos
        None where everything was up to date already.
    up_to_date : bool
    """

    out: Path
    inputs: OrientInputs
    record: dict[str, Any]
    measured: Measured | None = None
    adjusted: Adjusted | None = None
    photos: OrientedPhotos | None = None
    up_to_date: bool = False

    @property
    def project_file(self) -> Path | None:
        """The project file that `stereomate run` goes on from; None without a datum."""
        path = self.out / ORIENTED
        return path if path.is_file() else None


DocumentWriter = Callable[[OrientResult], list[Path]]


def orient(
    path: str | Path,
    out: Path,
    options: OrientOptions | None = None,
    progress: ProgressSink | None = None,
    documents: DocumentWriter | None = None,
) -> OrientResult:
    """Orient the photographs of a project.

    Parameters
    ----------
    path : path
        The project file.
    out : Path
        Folder of the results; made if it is not there.
    options : OrientOptions, optional
    progress : callable, optional
        Gets the stage, what is done and what there is to do.
    documents : callable, optional
        Writes the report.

    Raises
    ------
    StereomateError
        One of its classes for each kind of wrong input or a place that cannot be written.
    NotDeterminedError
        If the photographs do not determine an orientation at all.
    """
    options = options or OrientOptions()
    tell = progress or (lambda stage, done, total: None)
    inputs = read_orient_inputs(path)
    for problem in inputs.problems:
        LOG.warning("left out: %s", problem.error)
    key = orient_key(inputs)
    with storing(out):
        out.mkdir(parents=True, exist_ok=True)
    done = None if options.fresh else finished(out, key)
    if done is not None:
        return OrientResult(out, inputs, done, up_to_date=True)
    with storing(out):
        # Where adjustment.json is, all is there: it goes first and comes last.
        (out / ADJUSTMENT).unlink(missing_ok=True)
        if options.fresh:
            (out / DATABASE).unlink(missing_ok=True)
    measured = measure_block(inputs, out / DATABASE, executor_of(options.threads), tell)
    adjusted = adjust_measured(inputs, measured, lambda d, n: tell("adjustment", d, n))
    if not adjusted.oriented:
        raise NotDeterminedError("orientation: no photograph could be oriented")
    if not adjusted.result.used.any():
        raise NotDeterminedError(
            "orientation: no image observation agrees with the others and with positions and control points: "
            "one of these is wrong as a whole (its unit, its CRS), or the principal distance is"
        )
    photos = oriented_photos(inputs, adjusted)
    record = adjustment_record(inputs, measured, adjusted, photos, key)
    result = OrientResult(out, inputs, record, measured, adjusted, photos)
    tell("documents", 0, 1)
    # The record goes last: where it is, all is there.
    write_results(out, inputs, adjusted, photos, record)
    if documents is not None:
        documents(result)
    write_record(out, record)
    tell("documents", 1, 1)
    return result


def orient_key(inputs: OrientInputs) -> str:
    """Hash of everything that defines the result."""
    folder = inputs.path.parent
    control = inputs.file.control
    names = [inputs.file.photos.orientation or None, inputs.file.orient.tie_points]
    if control is not None:
        names += [control.file, control.measurements]
    return run_key(
        software=__version__,
        project=inputs.file.model_dump(mode="json"),
        files={n: file_digest(folder / n) for n in names if n is not None and (folder / n).is_file()},
        photographs=[[photo.path.name, photo.digest] for photo in inputs.photos],
    )


def finished(out: Path, key: str) -> dict[str, Any] | None:
    """The record of a finished orientation of this key in a folder, if there is one."""
    try:
        record: Any = json.loads((out / ADJUSTMENT).read_bytes())
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) and record.get("key") == key else None
