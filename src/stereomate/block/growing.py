"""Adjust a model while it grows: what is joined by resection and intersection alone drifts.

The model is a free network of ideal image coordinates; gross errors that are still in it are weighed down.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from stereomate.block.loop import run_loop
from stereomate.block.models import Adjuster, BlockImages, Model
from stereomate.block.network import BlockCamera, ImagePoints, Network, Photographs, Points
from stereomate.block.options import BlockOptions
from stereomate.camera.distortion import NoDistortion
from stereomate.camera.model import Camera
from stereomate.errors import NotDeterminedError

# Pixels of a principal distance: any number does, the ideal coordinates have none.
_SCALE: Final = 1e4
_HUBER: Final = 2.5
_OPTIONS: Final = BlockOptions(max_iterations=15, relative_tolerance=1e-5, statistics=False)


def model_adjuster(images: BlockImages) -> Adjuster:
    """What adjusts a model of these observations in place; a model that cannot be stays as it is.

    A pair is left alone: its relative orientation is the adjustment.
    """
    side = 2 * math.ceil(_SCALE * (1.0 + float(np.abs(images.image).max(initial=0.0))))
    matrix = ((_SCALE, 0.0, side / 2.0), (0.0, -_SCALE, side / 2.0))
    camera = BlockCamera(Camera("ideal", (side, side), 1.0, (0.0, 0.0), matrix, NoDistortion()), {})

    def adjust(model: Model) -> None:
        photos = np.flatnonzero(model.joined)
        if len(photos) < 3:
            return
        known = model.used & model.joined[images.photo] & np.isfinite(model.points[images.point, 0])
        rays = np.bincount(images.point[known], minlength=images.points)
        rows = np.flatnonzero(known & (rays[images.point] >= 2))
        points, point = np.unique(images.point[rows], return_inverse=True)
        network = Network(
            (camera,),
            Photographs(
                tuple(map(str, photos.tolist())),
                np.zeros(len(photos), np.int64),
                model.centres[photos],
                model.rotations[photos],
            ),
            Points(tuple(map(str, points.tolist())), model.points[points]),
            ImagePoints(
                np.searchsorted(photos, images.photo[rows]),
                point.astype(np.int64),
                images.image[rows] * (_SCALE, -_SCALE) + side / 2.0,
                _SCALE * images.sigma[rows, None],
            ),
        )
        try:
            state = run_loop(network, _OPTIONS, width=_HUBER).state
        except NotDeterminedError:
            return
        model.centres[photos], model.rotations[photos] = state.centres, state.rotations
        model.points[points] = state.points

    return adjust
