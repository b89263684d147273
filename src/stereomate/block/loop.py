"""The refinement loop of a block: Gauss-Newton, damped only after a step that did not lower the cost."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stereomate.block.absorbed import followed
from stereomate.block.datum import Defect, find_defect, held, onto_start
from stereomate.block.equations import (
    Equations,
    Factored,
    Step,
    build,
    camera_arrays,
    factor,
    solve,
    workspace_of,
)
from stereomate.block.kernels.points import outside
from stereomate.block.kernels.projection import residuals as kernel_residuals
from stereomate.block.network import Network
from stereomate.block.open_datum import open_datum
from stereomate.block.options import BlockOptions
from stereomate.block.prepared import Prepared, fixed_axes_applied, prepare
from stereomate.block.steps import longer, moved_by, shorter
from stereomate.block.unknowns import State, start_of
from stereomate.errors import InputError, NotDeterminedError
from stereomate.tiles.threads import limit_library_threads

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Progress = Callable[[int, float], None]

_FIRST_DAMPING: Final = 1e-4
_LARGEST_DAMPING: Final = 1e8
_SINGULAR_DAMPING: Final = 1e-2
# A step that is too long is made shorter before it is damped: damping holds what the block hardly
# determines (its tilt by poor positions, a bend) far more than a curved path asks for.
_LEAST_SHARE: Final = 0.02
# Steps that promise less than this part of the one before shrink fast: the next one is foreseen.
_FAST: Final = 0.01
# Coordinates that were corrected for distortion may lie as much of the larger side beyond the edge.
_EDGE: Final = 0.05
_PHOTO_UNKNOWNS: Final = ("X0", "Y0", "Z0", "rotation x", "rotation y", "rotation z")


@dataclass(frozen=True, eq=False)
class Linearised:
    """Equations and their factor, with the width of Huber's loss they were built with."""

    equations: Equations
    factored: Factored
    width: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the loop ended.

    Attributes
    ----------
    prepared : Prepared
    start, state : State
    cost : float
        Weighted sum of squares (or of losses).
    iterations, damped : int
        All, and those that needed damping.
    converged : bool
    defect : Defect
        What the observations leave open of the datum.
    lonely : ndarray of bool, shape (n,)
        Photographs that too few observations determine; they keep their start.
    notes : tuple of str
    linearised : Linearised or None
        The equations of the last step, where the state is still theirs.
    """

    prepared: Prepared
    start: State
    state: State
    cost: float
    iterations: int
    damped: int
    converged: bool
    defect: Defect
    lonely: Mask
    notes: tuple[str, ...]
    linearised: Linearised | None = field(default=None, repr=False)

    @property
    def used(self) -> Mask:
        """Image observations that took part, in the order of the network."""
        used = np.zeros(len(self.prepared.order), np.bool_)
        used[self.prepared.order] = self.prepared.weight[:, 0] > 0.0
        return used

    @property
    def determined(self) -> Mask:
        """Points that observations that took part determine."""
        rays = np.bincount(
            self.prepared.point[self.prepared.weight[:, 0] > 0.0], minlength=len(self.state.points)
        )
        return np.asarray(rays > 0)


@functools.cache
def _one_thread() -> None:
    """Once: threads of BLAS make small factorisations slower, not faster."""
    limit_library_threads()


def image_residuals(prepared: Prepared, state: State) -> Array:
    """Observed minus computed pixels (m, 2) in the order of the network; NaN where none can be computed."""
    cameras, network = camera_arrays(prepared, state), prepared.network
    out = np.empty((len(network.image.photo), 2))
    kernel_residuals(
        network.image.photo, network.image.point, network.image.xy, state.points, state.centres,
        state.rotations, network.photographs.camera, cameras.model, cameras.packed, out,
    )  # fmt: skip
    return out


def run_loop(
    network: Network,
    options: BlockOptions,
    used: Mask | None = None,
    width: float = math.inf,
    progress: Progress | None = None,
    state: State | None = None,
) -> Solution:
    """Adjust once with given observations.

    Parameters
    ----------
    network : Network
    options : BlockOptions
    used : ndarray of bool, shape (m,), optional
        Image observations that take part.
    width : float
        Of Huber's loss on image points; infinite for none.
    progress : callable, optional
        Gets the number of the iteration and the cost.
    state : State, optional
        Where to begin, if not at the start of the network; priors stay those of the network.

    Raises
    ------
    NotDeterminedError
        If an unknown is not determined; the message names it.
    InputError
        If the network has a datum defect and ``options.free_network`` is ``none``.
    """
    _one_thread()
    defect = find_defect(network, used)
    notes: list[str] = []
    if defect.size:
        if options.free_network == "none":
            raise InputError(
                f"must determine the datum; open: {', '.join(open_datum(network, defect))}",
                field="network",
                hint="control points or positions are missing; free_network allows inner constraints",
            )
        notes.append(f"datum by inner constraints: open were {', '.join(open_datum(network, defect))}")
        network = held(network, defect)
    outside = outside_photographs(network)
    if outside.any():
        used = ~outside if used is None else used & ~outside
        notes.append(_outside_note(network, outside))
    prepared = prepare(network, used)
    prepared, lonely = _without_lonely(prepared)
    if lonely.any():
        names = [name for name, is_one in zip(network.photographs.names, lonely, strict=True) if is_one]
        notes.append(
            f"{len(names)} photographs are not determined, too few observations: {', '.join(names[:5])}"
        )
    start = start_of(network, prepared.layout)
    first = state or start
    first = replace(first, points=fixed_axes_applied(prepared, first.points))
    loop = _Loop(prepared, start, first, options, width, progress)
    loop.run()
    final, linearised = loop.state, loop.linearised
    if defect.size:
        linearised = None
        final = onto_start(final, start, defect, np.bincount(prepared.point, minlength=len(final.points)) > 0)
        final = followed(loop.prepared.network, loop.prepared.layout, loop.state, final)
    return Solution(
        loop.prepared, start, final, loop.cost, loop.iterations, loop.damped, loop.converged, defect, lonely,
        (*notes, *loop.notes), linearised,
    )  # fmt: skip


def outside_photographs(network: Network) -> Mask:
    """Image observations that lie outside the pixel array of their photograph."""
    sizes = np.array([entry.camera.size_px for entry in network.cameras], dtype=np.float64)
    out = np.empty(len(network.image.photo), np.bool_)
    outside(network.image.photo, network.image.xy, network.photographs.camera, sizes, _EDGE, out)
    return out


def _outside_note(network: Network, outside: Mask) -> str:
    image, points, photos = network.image, network.points.names, network.photographs.names
    rows = np.flatnonzero(outside)
    places = [f"{points[image.point[row]]} in {photos[image.photo[row]]}" for row in rows[:5].tolist()]
    return f"{len(rows)} image observations left out, outside their photograph: {', '.join(places)}"


def _without_lonely(prepared: Prepared) -> tuple[Prepared, Mask]:
    """Without photographs that too few observations determine: what nothing else observes of them is held."""
    network = prepared.network
    n = len(network.photographs.names)
    placed, turned = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    if network.positions is not None:
        placed[network.positions.photo[np.isfinite(network.positions.sigma).all(axis=1)]] = True
    if network.attitudes is not None:
        turned[network.attitudes.photo[np.isfinite(network.attitudes.sigma).all(axis=1)]] = True
    lonely = np.zeros(n, np.bool_)
    while True:
        rays = np.bincount(prepared.photo[prepared.weight[:, 0] > 0.0], minlength=n)
        free = prepared.free_photo.sum(axis=1)
        enough = (2 * rays + 3 * placed + 3 * turned >= free) & (turned | (rays >= np.minimum(2, free)))
        new = ~enough & (free > 0) & ~lonely
        if not new.any():
            return prepared, lonely
        lonely |= new
        used = np.zeros(len(prepared.order), np.bool_)
        used[prepared.order] = (prepared.weight[:, 0] > 0.0) & ~lonely[prepared.photo]
        fixed = network.photographs.fixed
        held_ones = np.zeros((n, 6), np.bool_) if fixed is None else fixed.copy()
        held_ones[lonely & ~placed, :3] = True
        held_ones[lonely & ~turned, 3:] = True
        photographs = replace(network.photographs, fixed=held_ones)
        prepared = prepare(replace(network, photographs=photographs), used)


def _computable(prepared: Prepared, state: State) -> tuple[Prepared, int]:
    """Without the observations whose points lie behind their camera at the start."""
    residual = image_residuals(prepared, state)[prepared.order]
    bad = ~np.isfinite(residual[:, 0]) & (prepared.weight[:, 0] > 0.0)
    if not bad.any():
        return prepared, 0
    used = np.zeros(len(prepared.order), np.bool_)
    used[prepared.order] = (prepared.weight[:, 0] > 0.0) & ~bad
    return prepare(prepared.network, used), int(np.count_nonzero(bad))


class _Loop:
    """The loop's moving parts."""

    def __init__(
        self,
        prepared: Prepared,
        start: State,
        state: State,
        options: BlockOptions,
        width: float,
        progress: Progress | None,
    ) -> None:
        self.prepared, self.start, self.state = prepared, start, state
        self.options, self.width, self.progress = options, width, progress
        self.workspace = workspace_of(prepared)
        self.cost = math.inf
        self.damping = 0.0
        self.iterations = self.damped = 0
        self.converged = False
        self.singular = ""
        self.notes: list[str] = []
        self.linearised: Linearised | None = None

    def run(self) -> None:
        """Iterate to the end; what could not be reached is noted."""
        previous: State | None = None
        step: Step | None = None
        before: Step | None = None
        last_promised = math.inf
        share = 1.0
        stuck = was_singular = False
        while self.iterations < self.options.max_iterations:
            equations = self._built()
            worse = not equations.cost < self.cost or equations.failed > 0 or self._lost(equations)
            if previous is not None and worse and not self._is_rounding(equations, last_promised):
                before = None
                if step is not None and self.damping == 0.0 and share > _LEAST_SHARE:
                    share *= shorter(step.promised, equations.cost - self.cost, share)
                    self.state = moved_by(self.prepared, previous, step, share)
                    self.damped += 1
                    self.iterations += 1
                    continue
                self.state = previous
                self.damping = max(10.0 * self.damping, _FIRST_DAMPING)
                if self.damping > _LARGEST_DAMPING:
                    break
                self.damped += 1
                self.iterations += 1
                equations = self._built()
            elif previous is not None:
                self.damping = 0.0 if self.damping <= _FIRST_DAMPING else self.damping / 10.0
            self.cost = equations.cost
            self.iterations += 1
            if self.progress is not None:
                self.progress(self.iterations, self.cost)
            factored = factor(self.prepared, equations)
            while factored.singular >= 0:
                # Far from the solution the matrix may be worse than the network is.
                if self.damping > _SINGULAR_DAMPING or stuck:
                    raise NotDeterminedError(self._name(factored.singular) + " is not determined")
                self.damping = max(10.0 * self.damping, _FIRST_DAMPING)
                self.damped += 1
                was_singular = True
                self.singular = self._name(factored.singular)
                equations = self._built()
                factored = factor(self.prepared, equations)
            step = solve(self.prepared, equations, factored, self.state)
            is_end = self._is_end(step.promised, last_promised)
            share = longer(before, step) if self.damping == 0.0 and not is_end else 1.0
            before = step if share == 1.0 else None
            previous, last_promised = self.state, step.promised
            self.state = moved_by(self.prepared, previous, step, share)
            if is_end:
                self.converged = True
                # The step that is left is next to nothing: what follows from the equations holds at its end.
                self.linearised = Linearised(equations, factored, self.width)
                self.cost -= step.promised if math.isinf(self.width) else 0.0
                break
            self.singular = self.singular if was_singular else ""
            stuck = was_singular and step.promised <= 1e-6 * self.cost
            was_singular = False
        if self.converged:
            return
        if self.singular:
            raise NotDeterminedError(self.singular + " is not determined")
        self.notes.append(f"not converged after {self.iterations} iterations")

    def _is_end(self, promised: float, before: float) -> bool:
        """Whether a step is the last: it promises next to nothing, or the one after it would, and less."""
        if self.damping > 0.0:
            return False
        enough = self.options.relative_tolerance * max(self.cost, 1e-30)
        if promised <= enough:
            return True
        # Once steps shrink fast the next one shrinks by this rate at least; it is not taken, so less is let.
        fast = math.isinf(self.width) and promised < _FAST * before < math.inf
        return fast and promised * (promised / before) <= 1e-3 * enough

    def _is_rounding(self, equations: Equations, promised: float) -> bool:
        """Whether a cost that did not fall is one of rounding: the step promised next to nothing."""
        return promised <= 1e-9 * self.cost and equations.cost - self.cost <= 1e-12 * self.cost

    def _built(self) -> Equations:
        equations = build(self.prepared, self.state, self.start, self.width, self.damping, self.workspace)
        if math.isinf(self.cost) and equations.failed:
            self.prepared, count = _computable(self.prepared, self.state)
            self.workspace = workspace_of(self.prepared)
            self.notes.append(
                f"{count} image observations left out: the start puts their points behind the camera"
            )
            return self._built()
        if math.isinf(self.cost) and self._lost(equations):
            # Parallel rays at the start: such a point says nothing, and would be taken as known.
            weak = ~equations.solvable & self._seen()
            used = np.zeros(len(self.prepared.order), np.bool_)
            used[self.prepared.order] = (self.prepared.weight[:, 0] > 0.0) & ~weak[self.prepared.point]
            self.prepared = prepare(self.prepared.network, used)
            self.workspace = workspace_of(self.prepared)
            names = [self.prepared.network.points.names[j] for j in np.flatnonzero(weak)[:5]]
            self.notes.append(
                f"{int(weak.sum())} points left out, their rays are parallel: {', '.join(names)}"
            )
            return self._built()
        return equations

    def _seen(self) -> Mask:
        rows = self.prepared.point[self.prepared.weight[:, 0] > 0.0]
        return np.asarray(np.bincount(rows, minlength=len(self.state.points)) > 0)

    def _lost(self, equations: Equations) -> bool:
        """Whether points that observations take part for have no solution."""
        if not equations.undetermined:
            return False
        return bool((~equations.solvable & self._seen()).any())

    def _name(self, index: int) -> str:
        """What an index of the normal equations stands for."""
        names = self.prepared.network.photographs.names
        if index >= 6 * len(names):
            return self.prepared.layout.names[index - 6 * len(names)]
        photo = int(np.flatnonzero(self.prepared.place == index // 6)[0])
        return f"{_PHOTO_UNKNOWNS[index % 6]} of photograph {names[photo]}"
