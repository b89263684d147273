"""What a project asks of the self-calibration of its cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from stereomate.block.orient_network import NOMINAL, calibratable, parameters_of
from stereomate.camera.distortion import EbnerDeformation
from stereomate.camera.model import EBNER_NAMES, Camera
from stereomate.errors import InputError, ProjectError
from stereomate.project.orient_inputs import OrientInputs
from stereomate.project.orient_photos import RawPhoto
from stereomate.project.schema import CameraSection

_TWELVE: Final = frozenset(EBNER_NAMES)


def calibrated_camera(inputs: OrientInputs, photo: RawPhoto) -> tuple[Camera, tuple[str, ...]]:
    """Camera of a photograph with room for what is found of it, and the keys of that.

    Raises
    ------
    ProjectError
        If the camera's model has no room for it.
    """
    camera, keys = photo.camera, _keys(inputs, photo)
    try:
        if camera.deformation is None and _TWELVE & set(keys) and photo.format_mm is not None:
            # The grid is that of the picture, not of the scan with its frame.
            camera = replace(camera, deformation=EbnerDeformation.of_format(photo.format_mm))
        calibratable(camera, keys)
    except InputError as error:
        raise ProjectError(
            f"cannot be calibrated for {', '.join(keys)}: its distortion {error.rule}",
            file=inputs.path,
            field="orient.calibrate",
            value=camera.name,
        ) from error
    return camera, keys


def prior_sigmas(inputs: OrientInputs, camera: str) -> Mapping[str, float]:
    """Standard deviations of priors that the project states, by parameter; those of the camera come last."""
    section = _section(inputs, camera)
    stated: dict[str, float] = {}
    for source in (inputs.file.orient.priors, {} if section is None else section.priors):
        # A single parameter is said more exactly than all of a kind.
        for key in sorted(source, key=lambda key: -len(parameters_of(key))):
            stated |= dict.fromkeys(parameters_of(key), source[key])
    return stated


def is_automatic(inputs: OrientInputs, camera: str) -> bool:
    """Whether what is found of a camera is left to this program: then only what the block determines."""
    return _wanted(inputs, camera) == "auto"


def _wanted(inputs: OrientInputs, camera: str) -> tuple[str, ...] | str:
    section = _section(inputs, camera)
    if section is not None and section.calibrate is not None:
        return section.calibrate
    return inputs.file.orient.calibrate


def _keys(inputs: OrientInputs, photo: RawPhoto) -> tuple[str, ...]:
    wanted = _wanted(inputs, photo.camera.name)
    if wanted == "none":
        return ()
    if wanted == "auto":
        return () if photo.calibrated else NOMINAL
    expanded = [parameters_of(key) if key == "ebner" else (key,) for key in wanted]
    return tuple(dict.fromkeys(key for keys in expanded for key in keys))


def _section(inputs: OrientInputs, camera: str) -> CameraSection | None:
    """The section of a camera, or of that which it was told apart from."""
    return next((s for s in inputs.file.camera if camera == s.name or camera.startswith(f"{s.name} (")), None)
