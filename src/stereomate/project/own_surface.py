"""`stereomate surface`: surface and terrain of oriented photographs, for projects without a height model.

What limits the search is a first, coarse ground: the height model of the project if there is one (as the
surface through tie points that `stereomate orient` leaves), else tie points measured for it.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from stereomate import __version__
from stereomate.dense.ground_filter import GroundOptions
from stereomate.dense.surface import SURFACE, TERRAIN, SurfaceModelOptions, make_surface
from stereomate.dense.surface_plan import PlanOptions, plan_surface
from stereomate.dense.terrain_model import TerrainOptions
from stereomate.project.first_ground import first_ground
from stereomate.project.loader import load
from stereomate.project.model import Project
from stereomate.project.orient_files import absolute_document
from stereomate.project.reading import read_project_file
from stereomate.project.schema import SurfaceSection
from stereomate.project.toml_text import toml_text
from stereomate.raster.files import storing, write_whole
from stereomate.tiles.executor import executor_of
from stereomate.tiles.ledger import run_key

LOG = logging.getLogger(__name__)

RECORD: Final = "surface.json"
PROJECT: Final = "project.toml"
FORMAT: Final = 1


@dataclass(frozen=True, eq=False)
class OwnSurface:
    """The surface of a project.

    Attributes
    ----------
    out : Path
    record : dict
        What `surface.json` holds.
    up_to_date : bool
    """

    out: Path
    record: dict[str, Any]
    up_to_date: bool = False

    @property
    def project_file(self) -> Path:
        """The project with its own height model: `stereomate run` goes on from it."""
        return self.out / PROJECT


def make_own_surface(
    path: str | Path,
    out: Path,
    threads: int = 1,
    fresh: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> OwnSurface:
    """Make surface and terrain of the oriented photographs of a project.

    Parameters
    ----------
    path : path
        A project file with orientation.
    out : Path
        Folder of the results; made if it is not there.
    threads : int
    fresh : bool
        Forget what an earlier run left.
    progress : callable, optional
        Gets the stage, what is done and what there is to do.

    Raises
    ------
    StereomateError
        One of its classes for each kind of wrong input or a place that cannot be written.
    NotDeterminedError
        If no two photographs show common ground from different places.
    """
    path = Path(path)
    tell = progress or (lambda stage, done, total: None)
    project = load(path)
    section = read_project_file(path).surface
    key = _key(project, section)
    with storing(out):
        out.mkdir(parents=True, exist_ok=True)
    done = None if fresh else _finished(out, key)
    if done is not None:
        return OwnSurface(out, done, up_to_date=True)
    with storing(out):
        (out / RECORD).unlink(missing_ok=True)
    executor = executor_of(threads)
    model = project.heights or first_ground(path, project, out, executor, tell)
    with storing(out):
        plan = plan_surface(
            project.survey,
            model,
            PlanOptions(section.largest_side_px, section.pairs_per_photo, section.cell),
        )
        options = SurfaceModelOptions(
            terrain=TerrainOptions(ground=GroundOptions(largest_object_m=section.largest_object_m))
        )
        result = make_surface(plan, out, run_key(inputs=key, fresh=fresh), options, executor, tell)
    used = TERRAIN if section.use == "terrain" else SURFACE
    record = {
        "format": FORMAT,
        "kind": "surface",
        "software": f"stereomate {__version__}",
        "key": key,
        "files": [result.surface.name, result.terrain.name, result.quality.name],
        "used": used,
        "cell": plan.grid.cell,
        "reduction": plan.reduction,
        **result.figures,
    }
    write_whole(out / PROJECT, [_project_text(path, used).encode()])
    write_whole(out / RECORD, [(json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode()])
    LOG.info("%s", words(record))
    return OwnSurface(out, record)


def words(record: dict[str, Any]) -> str:
    """What was made, in one line."""
    pairs = record["pairs"]
    return (
        f"no height model: a surface of {record['measured_cells']} cells of {record['cell']:g} was matched "
        f"in {len(pairs)} pairs, {record['filled_cells']} cells filled; products are made on {record['used']}"
    )


def _key(project: Project, section: SurfaceSection) -> str:
    return run_key(
        software=__version__,
        files=[[item.role, item.path.name, item.digest] for item in project.inputs if item.role != "project"],
        project={name: project.document[name] for name in ("project", "camera", "photos")},
        surface=section.model_dump(mode="json"),
        model=None if project.heights is None else project.heights.content_hash,
    )


def _finished(out: Path, key: str) -> dict[str, Any] | None:
    try:
        record: Any = json.loads((out / RECORD).read_bytes())
    except (OSError, ValueError):
        return None
    if not isinstance(record, dict) or record.get("key") != key:
        return None
    return record if all((out / name).is_file() for name in (*record["files"], PROJECT)) else None


def _project_text(path: Path, used: str) -> str:
    """The project file with the surface as its height model; paths are absolute."""
    document = absolute_document(read_project_file(path), path.parent)
    document["terrain"] = {"file": used}
    return (
        f"# Written by stereomate surface: {path.name} with the height model matched from its photographs.\n"
        "# stereomate run goes on from here.\n\n" + toml_text(document)
    )
