"""The folder of a run: what an earlier run left there, what is up to date, what has gone stale."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from stereomate.errors import FormatError
from stereomate.project.inputs import file_digest
from stereomate.project.model import Project
from stereomate.raster.files import storing, write_whole
from stereomate.stereo.product import read_document

WORKSPACE: Final = ".stereomate"

Record = dict[str, Any]


@dataclass(frozen=True)
class OutputFolder:
    """Where a run writes. stereo.json is written last: where it is, all is there."""

    out: Path

    @property
    def workspace(self) -> Path:
        """What lives only while the run is not finished."""
        return self.out / WORKSPACE

    @property
    def _record(self) -> Path:
        return self.out / "stereo.json"

    @property
    def _retired(self) -> Path:
        return self.workspace / "retired.json"

    @property
    def _unreadable(self) -> Path:
        return self.workspace / "unreadable.json"

    def is_made(self, key: str) -> bool:
        """Whether a finished run of this key is here, with all its files, unchanged.

        Raises
        ------
        FormatError
            If there is a stereo.json that cannot be read, or is of a newer version.
        """
        if not self._record.is_file():
            return False
        document = read_document(self._record)
        if document.get("run", {}).get("key") != key:
            return False
        rasters, documents = self._files(document)
        return all((self.out / name).is_file() for name in documents) and all(
            (self.out / name).is_file() and file_digest(self.out / name) == digest
            for name, digest in rasters.items()
        )

    def retire(self) -> None:
        """Take back what stereo.json says; its list of files is kept until they are replaced or removed."""
        if self._record.is_file():
            with storing(self.workspace):
                self.workspace.mkdir(exist_ok=True)
                os.replace(self._record, self._retired)

    def remove_stale(self, made: set[str]) -> None:
        """Remove the files of the run before that this one did not make, but for those changed since."""
        if not self._retired.is_file():
            return
        try:
            rasters, documents = self._files(read_document(self._retired))
        except FormatError:
            # Damaged, or of a newer version: nobody knows what is its own.
            return
        for name in (*rasters, *documents):
            path = self.out / name
            if name in made or Path(name).name != name or not path.is_file():
                continue
            if name in documents or file_digest(path) == rasters[name]:
                with storing(path):
                    path.unlink()

    def forget(self) -> None:
        """Remove the workspace."""
        shutil.rmtree(self.workspace, ignore_errors=True)

    def unreadable(self, project: Project) -> dict[str, str]:
        """Photographs that an earlier run could not read, with their SHA-256, if their files are the same."""
        paths = {p.name: p.path for p in project.survey.photographs}
        found = {}
        for name, digest in self._known_unreadable().items():
            path = paths.get(name)
            if path is not None and file_digest(path) == digest:
                found[name] = digest
        return found

    def note_unreadable(self, digests: dict[str, str]) -> None:
        """Keep which photographs could not be read, for a run that goes on."""
        if digests:
            with storing(self.workspace):
                self.workspace.mkdir(exist_ok=True)
                write_whole(self._unreadable, [json.dumps(digests, indent=1).encode()])

    def _known_unreadable(self) -> dict[str, str]:
        """From the run that was stopped, else from the last one that was finished."""
        with contextlib.suppress(OSError, ValueError):
            known: dict[str, str] = json.loads(self._unreadable.read_bytes())
            return known
        if not self._record.is_file():
            return {}
        return dict(read_document(self._record).get("run", {}).get("unreadable", {}))

    def _files(self, document: Record) -> tuple[dict[str, str], list[str]]:
        """Rasters with their SHA-256, and documents, of a stereo.json."""
        try:
            rasters = {
                str(name): str(digest)
                for record in document["products"]
                for name, digest in record["sha256"].items()
            }
            return rasters, [str(name) for name in document.get("run", {}).get("documents", [])]
        except (KeyError, TypeError, AttributeError) as error:
            raise FormatError(f"lacks or garbles a value ({error})", file=self._record) from error
