"""Tie points of a block: features of every photograph, matches of every pair, points of the whole block.

Everything finished is kept in a measurement database at once, so that a run that was killed goes on with the
photograph or pair it was at. The result is the same whether a run went through or was taken up again, and
whatever the number of threads: later steps read what the database holds, not what is in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from stereomate.block.models import PairPose
from stereomate.block.photos import BlockPhoto, features_of_photo, is_mirrored
from stereomate.block.start_pairs import (
    Approximation,
    PairOptions,
    PairSelection,
    pairs_by_first_look,
    select_pairs,
)
from stereomate.errors import ImageError, NotDeterminedError
from stereomate.measurement.database import MeasurementDatabase, PairRow
from stereomate.measurement.features import FeatureOptions, Features
from stereomate.measurement.tracks import PairMatches, ThinningOptions, TiePoints, join_matches, thin
from stereomate.relative.feature_pairs import (
    FEATURE_SIGMA_PX,
    AutomaticOptions,
    FeaturePair,
    reduction,
)
from stereomate.tiles import Executor, map_items
from stereomate.tiles.ledger import run_key

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

FEATURES_OF_A_BLOCK: Final = FeatureOptions(max_features=6000)
# Cached features of this many photographs: pairs of neighbours follow each other.
_CACHED: Final = 64
# A copy, perhaps strongly compressed: of so many of the largest features this share is at the same place to
# so many pixels of the reduced image, with descriptors of this cosine.
_LOOKED_AT: Final = 400
_LEAST_FEATURES: Final = 50
_SAME_PX: Final = 1.0
_ALIKE: Final = 0.9
_SAME_SHARE: Final = 0.5


@dataclass(frozen=True)
class TiePointOptions:
    """Options of the steps.

    Parameters
    ----------
    automatic : stereomate.relative.feature_pairs.AutomaticOptions
        Features, matching and relative orientation of pairs.
    pairs : stereomate.block.start_pairs.PairOptions
    thinning : ThinningOptions
    """

    automatic: AutomaticOptions = field(
        default_factory=lambda: AutomaticOptions(features=FEATURES_OF_A_BLOCK, least_points=20)
    )
    pairs: PairOptions = field(default_factory=PairOptions)
    thinning: ThinningOptions = field(default_factory=ThinningOptions)


@dataclass(frozen=True)
class PairResult:
    """What came of a pair: counts of features and matches; reasons if it gave no orientation.

    `same_picture`: all of their features lie at the same pixels.
    """

    first: int
    second: int
    counts: Mapping[str, int]
    reasons: tuple[str, ...]
    same_picture: bool = False


def find_features(
    database: MeasurementDatabase,
    photos: Sequence[BlockPhoto],
    options: TiePointOptions,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> dict[int, str]:
    """Find the features of every photograph that the database does not hold yet.

    Returns
    -------
    dict
        Number of a photograph -> why it could not be read.
    """
    done = database.done("features")
    keys = {photo.number: _features_key(photo, options) for photo in photos}
    todo = [p for p in photos if done.get(str(p.number), ("", {}))[0] != keys[p.number]]
    count = len(photos) - len(todo)
    failed = {p.number: str(done[str(p.number)][1]["error"]) for p in photos if p not in todo
              and "error" in done[str(p.number)][1]}  # fmt: skip
    nothing = Features(np.empty((0, 2)), *(np.empty(0),) * 3, np.empty((0, 128), np.float32))

    def work(photo: BlockPhoto) -> tuple[Features, str]:
        try:
            return features_of_photo(photo, options.automatic), ""
        except ImageError as error:
            return nothing, str(error)

    def keep(photo: BlockPhoto, found: tuple[Features, str]) -> None:
        nonlocal count
        features, error = found
        record: dict[str, Any] = {"features": len(features)}
        if error:
            record["error"] = failed[photo.number] = error
        database.put_features(photo.number, features, keys[photo.number], record)
        count += 1
        if progress is not None:
            progress(count, len(photos))

    if progress is not None:
        progress(count, len(photos))
    _each(work, todo, keep, executor)
    return failed


def choose_pairs(
    database: MeasurementDatabase,
    photos: Sequence[BlockPhoto],
    known: Approximation,
    options: TiePointOptions,
) -> PairSelection:
    """Pairs to compare, as indices into `photos`."""
    chosen = select_pairs([photo.camera for photo in photos], known, options.pairs)
    if chosen is not None:
        return chosen
    return pairs_by_first_look([database.features(p.number) for p in photos], options.pairs)


def match_pairs(
    database: MeasurementDatabase,
    photos: Sequence[BlockPhoto],
    selection: PairSelection,
    options: TiePointOptions,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> tuple[PairResult, ...]:
    """Match and orient every chosen pair that the database does not hold yet."""
    features_key = {name: key for name, (key, _) in database.done("features").items()}
    done = database.done("pair")
    names = {pair: f"{photos[pair[0]].number}-{photos[pair[1]].number}" for pair in selection.pairs}
    keys = {pair: _pair_key(pair, photos, features_key, options) for pair in selection.pairs}
    todo = [pair for pair in selection.pairs if done.get(names[pair], ("", {}))[0] != keys[pair]]
    count = len(selection.pairs) - len(todo)
    cache = _FeatureCache(database)

    def work(pair: tuple[int, int]) -> tuple[PairRow, Any, dict[str, Any]]:
        return _oriented(photos[pair[0]], photos[pair[1]], cache, options)

    def keep(pair: tuple[int, int], found: tuple[PairRow, Any, dict[str, Any]]) -> None:
        nonlocal count
        database.put_pair(found[0], found[1], keys[pair], found[2])
        count += 1
        if progress is not None:
            progress(count, len(selection.pairs))

    if progress is not None:
        progress(count, len(selection.pairs))
    _each(work, todo, keep, executor)
    records = database.done("pair")
    return tuple(
        PairResult(
            *pair,
            records[names[pair]][1]["counts"],
            tuple(records[names[pair]][1].get("reasons", ())),
            "same_picture" in records[names[pair]][1],
        )
        for pair in selection.pairs
    )


def _oriented(
    first: BlockPhoto, second: BlockPhoto, cache: _FeatureCache, options: TiePointOptions
) -> tuple[PairRow, Any, dict[str, Any]]:
    pair = FeaturePair(
        first.camera, second.camera, cache.of(first.number), cache.of(second.number), options.automatic
    )
    none = np.empty((0, 2), dtype=np.int64)
    if shows_same_picture(pair):
        empty = np.empty(0, dtype=np.int64)
        record = {"counts": {}, "reasons": ["they show the same picture"], "same_picture": True}
        return PairRow(first.number, second.number, none), _Rows(empty, empty), record
    try:
        found = pair.orient()
    except NotDeterminedError as error:
        row = PairRow(first.number, second.number, none)
        empty = np.empty(0, dtype=np.int64)
        matches = _Rows(empty, empty)
        return row, matches, {"counts": {}, "reasons": [str(error)]}
    record = {"counts": found.counts}
    if found.reasons:
        record["reasons"] = list(found.reasons)
    used = found.used
    record["quality"] = [round(float(v), 5) for v in used.ratio]
    if found.orientation is None or _contradicted(found.reasons):
        record["quality"] = []
        return PairRow(first.number, second.number, none), found.matches, record
    rows = np.column_stack([used.left, used.right])
    pose = found.orientation.pose
    if found.reasons:
        # The points agree with an epipolar geometry, though it does not fix all elements: they still tie.
        return PairRow(first.number, second.number, rows), found.matches, record
    return (
        PairRow(first.number, second.number, rows, pose.base, pose.left_from_right),
        found.matches,
        record,
    )


def shows_same_picture(pair: FeaturePair) -> bool:
    """Whether most of the strongest features of two photographs are at the same pixels, and alike.

    Two photographs from different places have hardly any such; from one place, without a base, they are of
    no more use together than a copy is.
    """
    one, other = pair.left_features, pair.right_features
    if pair.left_camera.size_px != pair.right_camera.size_px or min(len(one), len(other)) < _LEAST_FEATURES:
        return False
    few = np.argsort(-one.size_px, kind="stable")[:_LOOKED_AT]
    apart, nearest = cKDTree(other.pixels).query(one.pixels[few])
    near = apart <= _SAME_PX * reduction(pair.left_camera.size_px, pair.options)
    alike = np.sum(one.descriptors[few] * other.descriptors[nearest], axis=1)
    size = np.linalg.norm(one.descriptors[few], axis=1) * np.linalg.norm(other.descriptors[nearest], axis=1)
    return bool(np.mean(near & (alike > _ALIKE * size)) > _SAME_SHARE)


def _contradicted(reasons: Sequence[str]) -> bool:
    """Whether matches of a pair without orientation are not to be trusted either."""
    return any("agree" in reason or "matches" in reason for reason in reasons)


@dataclass(frozen=True)
class _Rows:
    left: NDArray[np.int64]
    right: NDArray[np.int64]


def tie_points(
    database: MeasurementDatabase,
    photos: Sequence[BlockPhoto],
    selection: PairSelection,
    options: TiePointOptions,
) -> tuple[TiePoints, dict[str, Any]]:
    """Points of the block from the matches in the database, thinned; kept there.

    Returns
    -------
    points : TiePoints
        Photographs in the order of `photos`.
    record : dict
        How many there were: tracks, observations, contradictions, kept.
    """
    wanted = {(photos[a].number, photos[b].number): (a, b) for a, b in selection.pairs}
    done = database.done("pair")
    matches = []
    for pair in database.pairs():
        if (pair.first, pair.second) not in wanted or not len(pair.rows):
            continue
        quality = np.array(done[f"{pair.first}-{pair.second}"][1]["quality"])
        matches.append(PairMatches(*wanted[pair.first, pair.second], pair.rows, quality))
    key = run_key(
        pairs=[[p.first, p.second, len(p.rows)] for p in matches],
        keys=sorted(key for key, _ in done.values()),
        thinning=vars(options.thinning),
    )
    before = database.done("tie points").get("")
    if before is not None and before[0] == key:
        return database.tie_points(), before[1]
    tracks = join_matches(matches)
    pixels, sigma = np.empty((len(tracks.point), 2)), np.empty(len(tracks.point))
    for k, photo in enumerate(photos):
        mine = tracks.photo == k
        if mine.any():
            pixels[mine] = database.keypoints(photo.number)[0][tracks.feature[mine]]
            sigma[mine] = FEATURE_SIGMA_PX * reduction(photo.camera.size_px, options.automatic)
    everything = TiePoints(
        tuple(photo.name for photo in photos), tracks.point, tracks.photo, pixels, sigma, tracks.feature
    )
    sizes = {k: photo.camera.size_px for k, photo in enumerate(photos)}
    kept = thin(everything, sizes, options.thinning)
    record = {
        "tracks": everything.count,
        "observations": len(everything),
        "contradictions": tracks.contradictions,
        "tie_points": kept.count,
        "tie_observations": len(kept),
    }
    database.put_tie_points(kept, key, record)
    # As they are read back, so that a run that goes on is like one that went through.
    return database.tie_points(), database.done("tie points")[""][1]


def pair_poses(
    database: MeasurementDatabase, photos: Sequence[BlockPhoto], selection: PairSelection
) -> tuple[PairPose, ...]:
    """Determined relative orientations of chosen pairs."""
    wanted = {(photos[a].number, photos[b].number): (a, b) for a, b in selection.pairs}
    return tuple(
        PairPose(*wanted[pair.first, pair.second], pair.base, pair.first_from_second)
        for pair in database.pairs()
        if (pair.first, pair.second) in wanted
        and pair.base is not None
        and pair.first_from_second is not None
    )


class _FeatureCache:
    """Features as the database holds them, those of the last photographs kept."""

    def __init__(self, database: MeasurementDatabase) -> None:
        self._database = database
        self._known: dict[int, Features] = {}

    def of(self, number: int) -> Features:
        found = self._known.get(number)
        if found is None:
            found = self._database.features(number)
            while len(self._known) >= _CACHED:
                # Another thread may have taken the oldest away in the meantime.
                self._known.pop(next(iter(list(self._known)), -1), None)
            self._known[number] = found
        return found


def _scan_key(photo: BlockPhoto) -> list[str]:
    projective = photo.camera.projective_per_mm
    return [repr(photo.camera.pixel_from_photo), *([] if projective == (0.0, 0.0) else [repr(projective)])]


def _features_key(photo: BlockPhoto, options: TiePointOptions) -> str:
    return run_key(
        photo=photo.digest,
        size=photo.camera.size_px,
        side=options.automatic.largest_side_px,
        features=vars(options.automatic.features),
        mirrored=is_mirrored(photo.camera),
        frame=None if photo.format_mm is None else [*photo.format_mm, *_scan_key(photo)],
    )


def _pair_key(
    pair: tuple[int, int],
    photos: Sequence[BlockPhoto],
    features: Mapping[str, str],
    options: TiePointOptions,
) -> str:
    one, other = photos[pair[0]], photos[pair[1]]
    return run_key(
        features=[features.get(str(p.number), "") for p in (one, other)],
        cameras=[repr(p.camera) for p in (one, other)],
        options=repr(options.automatic),
    )


def _each(
    work: Callable[[Any], Any],
    items: Sequence[Any],
    keep: Callable[[Any, Any], None],
    executor: Executor | None,
) -> None:
    """Work on items; each result is kept at once by the thread that made it."""

    def both(item: Any) -> None:
        keep(item, work(item))

    map_items(both, items, executor)
