"""The ``[[camera]]`` sections that `init` drafts: from camera files, reconstructions, or the photographs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from stereomate.camera.model import Camera
from stereomate.formats.camera_files import CameraFile
from stereomate.project.findings import Findings
from stereomate.project.sensors import DraftCamera, draft_camera
from stereomate.project.toml_text import camera_section, toml_text

Size = tuple[int, int]


def camera_sections(found: Findings, to_do: list[str]) -> list[str]:
    """Sections of all cameras; what is left to the user is added to `to_do`.

    Cameras of a reconstruction belong to its orientation; else a file of cameras counts more than what the
    photographs say of theirs.
    """
    if found.reconstructions and not found.tables:
        path = found.reconstructions[0].path.name
        return [f"# The cameras are those of {path}; [[camera]] sections here would take their place.\n"]
    sizes = list(dict.fromkeys(photo.info.size for photo in found.photographs))
    cameras: dict[str, tuple[Camera, str, bool]] = {}
    if found.reconstructions:
        source = "the cameras of the reconstruction"
        cameras = {c.name: (c, source, True) for c in found.reconstructions[0].cameras.values()}
    else:
        cameras = _of_files(found.cameras, sizes, _named_by_tables(found), to_do)
    written = [_known_section(*entry) for entry in cameras.values()]
    covered = {camera.size_px for camera, _, _ in cameras.values()}
    drafted: dict[tuple[str, Size], DraftCamera] = {}
    for photo in found.photographs:
        key = (photo.tags.model, photo.info.size)
        if photo.info.size not in covered and key not in drafted:
            drafted[key] = draft_camera(photo.tags, photo.info.size)
    several = len(drafted) + len(written) > 1
    for camera in drafted.values():
        if camera.lines[0].startswith("#"):
            to_do.append(f"camera {camera.name}: fill in the calibration")
        written.append(_drafted_section(camera, several))
    return written


def _named_by_tables(found: Findings) -> set[str]:
    return {row.camera for row in found.tables[0].table.rows if row.camera} if found.tables else set()


def _of_files(
    files: Iterable[CameraFile], sizes: Sequence[Size], named: set[str], to_do: list[str]
) -> dict[str, tuple[Camera, str, bool]]:
    """Of each size the cameras that the table names, else one; another size fits no photograph."""
    known = [(camera, file) for file in files for camera in file.cameras]
    cameras: dict[str, tuple[Camera, str, bool]] = {}
    for size in sizes:
        fitting = [entry for entry in known if entry[0].size_px == size]
        chosen = [entry for entry in fitting if entry[0].name in named] or fitting[:1]
        for camera, file in chosen:
            cameras.setdefault(camera.name, (camera, f"{file.path.name} ({file.program})", file.nominal))
    used = {camera for camera, _, _ in cameras.values()}
    for camera, file in known:
        if camera.size_px not in sizes:
            columns, rows = camera.size_px
            to_do.append(
                f"{file.path.name}: no photograph has the {columns} x {rows} pixels of {camera.name}"
            )
        elif camera.name not in cameras and camera not in used:
            to_do.append(f"{file.path.name}: camera {camera.name} is of the same size, and not used")
    return cameras


def _known_section(camera: Camera, source: str, nominal: bool) -> str:
    """A calibrated camera as text; where only pixels are known it is written in pixels."""
    section = camera_section(camera)
    note = f"# Source: {source}."
    if nominal:
        x, y = camera.image_from_photo(camera.principal_point_mm)
        distance, pitch = section.pop("principal_distance_mm"), section.pop("pixel_pitch_mm")
        del section["principal_point_mm"]
        section["principal_distance_px"] = distance / pitch[0]
        section["principal_point_px"] = [float(x), float(y)]
        if abs(pitch[0] / pitch[1] - 1.0) > 1e-12:
            section["pixel_pitch_mm"] = pitch  # carries the ratio of the focal lengths
        note = f"# Source: {source}; pixels only, so that millimetres are nominal."
    ordered = sorted(section.items(), key=lambda item: item[0] == "distortion")
    head, *lines = toml_text({"camera": [_rounded(dict(ordered))]}).splitlines()
    return "\n".join([head, note, *lines, ""])


def _rounded(value: object) -> object:
    """Numbers without the digits of a conversion there and back."""
    if isinstance(value, float):
        return float(f"{value:.12g}")
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value


def _drafted_section(camera: DraftCamera, several: bool) -> str:
    name = f"{camera.name} {camera.size_px[0]}x{camera.size_px[1]}" if several else camera.name
    head = toml_text({"camera": [{"name": name, "size_px": list(camera.size_px)}]})
    lines = "\n".join(camera.lines)
    return f"{head}# Source: {camera.source}.\n{lines}\n"
