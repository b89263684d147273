"""stereo.json: everything that defines the products of a run, written and read back.

The file lies beside the rasters. With it and the source photographs every pixel can be computed again, and
a point measured in orthophoto and stereomate can be traced back to the two photographs.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stereomate import __version__
from stereomate.coverage.covariance import OrientationCovariance
from stereomate.errors import FormatError, InputError
from stereomate.forms import STEREO
from stereomate.parallax.laws import ParallaxLaw, law_from_record
from stereomate.raster.files import write_whole
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.options import RectifyOptions
from stereomate.rectify.radiometry import balance_from_record, balance_record
from stereomate.rectify.seams import seams_from_record, seams_record
from stereomate.stereo import record as rec
from stereomate.stereo.lineage import lineage_of
from stereomate.stereo.measure import measure
from stereomate.stereo.measured import Measurement, MeasureOptions, ObjectHeights

Record = dict[str, Any]


@dataclass(frozen=True)
class ProductFiles:
    """Rasters of one product, names relative to the folder of stereo.json.

    Attributes
    ----------
    ortho, lineage : str
    mate : str or None
        None for an orthophoto without stereomate.
    hashes : mapping of str to str
        SHA-256 of each file.
    """

    ortho: str
    lineage: str
    mate: str | None
    hashes: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class StereoProduct:
    """A product: what it was computed from and how, and where its rasters are.

    Attributes
    ----------
    job : RectifyJob
        Models, law, grid, orientation, height model.
    files : ProductFiles
    folder : Path
        Of stereo.json.
    height_model_hash : str
        SHA-256 of the height model the product was made with.
    agreement : mapping or None
        Measured parallaxes, see `stereomate.stereo.agreement`.
    orientation : OrientationCovariance or None
        How well the photographs are oriented, along the axes of the job's tangent frame, where it is known.
    """

    job: RectifyJob
    files: ProductFiles
    folder: Path
    height_model_hash: str
    agreement: Mapping[str, Any] | None = None
    orientation: OrientationCovariance | None = None

    @classmethod
    def open(cls, path: str | Path, name: str | None = None, *, verify: bool = True) -> StereoProduct:
        """A product of a stereo.json, ready to be measured in.

        Parameters
        ----------
        path : path
            stereo.json, or the folder that holds it.
        name : str, optional
            Which product, where there are several; the first one if absent.
        verify : bool
            Read the rasters and the height model through and compare their hashes. A raster that is not there
            is not missed: positions measured elsewhere need only this file and the height model.

        Raises
        ------
        FormatError
            If the file is damaged, has no such product, or a raster was edited or resampled since.
        InputError
            If the height model is not the one that the product was made with, or not there.
        """
        path = Path(path)
        path = path / "stereo.json" if path.is_dir() else path
        products = read_products(path)
        for product in products:
            if name is None or product.job.name == name:
                if verify:
                    product.verify()
                return product
        names = ", ".join(repr(product.job.name) for product in products)
        raise FormatError(f"must be one of {names}", file=path, field="product", value=name)

    def raster_beside(self, kind: str) -> Path:
        """Where commands write a raster of the product: its ``surface``, its ``terrain`` check."""
        return self.folder / (f"{kind}_{self.job.name}.tif" if self.job.name else f"{kind}.tif")

    def verify(self) -> None:
        """Check that height model and rasters are those of the product.

        Raises
        ------
        FormatError, InputError
            As `open`.
        """
        if self.job.heights.path is not None and not self.job.heights.path.is_file():
            raise InputError(
                "must be there: every point is measured over the height model that the product was made with",
                file=self.job.heights.path,
                field="height_model.file",
            )
        if self.job.heights.content_hash != self.height_model_hash:
            raise InputError(
                "must be the height model that the product was made with: another one falsifies every point",
                file=self.job.heights.path,
                field="height_model.sha256",
                value=self.job.heights.content_hash,
            )
        for name, digest in self.files.hashes.items():
            path = self.folder / name
            if path.is_file():
                with path.open("rb") as file:
                    found = hashlib.file_digest(file, "sha256").hexdigest()
                if found != digest:
                    raise FormatError(
                        "was edited or resampled since it was made: positions on it mean nothing",
                        file=path,
                        field="sha256",
                        value=found,
                    )

    def measure(
        self, left_xy: ArrayLike, right_xy: ArrayLike, options: MeasureOptions | None = None
    ) -> Measurement:
        """Exact points from map positions (n, 2) on the orthophoto and on the stereomate.

        See `stereomate.stereo.measure.measure`.
        """
        lineage = lineage_of(self.job, self.folder / self.files.lineage if self.files.lineage else None)
        return measure(self.job, lineage, left_xy, right_xy, options, self.orientation)

    def measure_object(
        self,
        foot: tuple[ArrayLike, ArrayLike],
        top: tuple[ArrayLike, ArrayLike],
        options: MeasureOptions | None = None,
    ) -> ObjectHeights:
        """Heights of objects, exact and through the law: foot and top as (left_xy, right_xy)."""
        return ObjectHeights(self.measure(*foot, options), self.measure(*top, options))


def product_record(product: StereoProduct) -> Record:
    """One product as plain values."""
    job, folder = product.job, product.folder
    cameras = {p.camera.name: rec.camera_record(p.camera) for p in job.photographs}
    law = None if not job.is_stereo else job.law.as_record()
    return {
        "name": job.name,
        "files": {
            "ortho": product.files.ortho,
            "mate": product.files.mate,
            "lineage": product.files.lineage,
        },
        "sha256": dict(product.files.hashes),
        "law": law,
        "base": _base_record(job),
        "grid": rec.grid_record(job.grid),
        "frame": rec.frame_record(job.frame, folder),
        "tangent": rec.tangent_record(job.tangent),
        "height_model": rec.height_model_record(job.heights, folder),
        "height_range": list(job.height_range),
        "cameras": cameras,
        "photographs": [rec.photograph_record(p, folder) for p in job.photographs],
        "centres_in_height_model": job.centres_in_height_model.tolist(),
        "reductions": list(job.reductions),
        "models": [rec.model_record(m) for m in job.models],
        "seams": seams_record(job.seams),
        "balance": balance_record(job.balance),
        "bands": [band + 1 for band in job.bands],
        "dtype": str(job.dtype),
        "options": dataclasses.asdict(job.options),
        "agreement": product.agreement,
        "orientation_covariance": orientation_record(product),
    }


def orientation_record(product: StereoProduct) -> Record | None:
    """Covariances of what one can measure with: a left and a right photograph of any two models."""
    if product.orientation is None:
        return None
    job = product.job
    names = [photograph.name for photograph in job.photographs]
    left = {names[model.left] for model in job.models if model.left >= 0}
    right = {names[model.right] for model in job.models if model.right >= 0}
    pairs = ((a, b) for a in sorted(left) for b in sorted(right) if a != b)
    return product.orientation.among(names, pairs).as_record()


def _base_record(job: RectifyJob) -> Record | None:
    """Nominal base of the product: length, and azimuth of the rows in degrees from grid north."""
    if not job.is_stereo:
        return None
    azimuth = (90.0 - np.degrees(job.grid.rotation)) % 360.0
    return {"length": job.law.base_m, "grid_azimuth_deg": float(azimuth)}


def write_stereo_json(path: Path, products: list[StereoProduct], run: Record) -> None:
    """Write stereo.json, whole or not at all.

    Parameters
    ----------
    run : dict
        What the run says about itself: key of its definition, notes, inputs.
    """
    document = {
        "format": STEREO.version,
        "software": f"stereomate {__version__}",
        "run": run,
        "products": [product_record(p) for p in products],
    }
    text = json.dumps(_without_nan(document), indent=1, ensure_ascii=False, allow_nan=False)
    write_whole(path, [text.encode()])


def read_document(path: Path) -> Record:
    """The document of a stereo.json, migrated to the present form.

    Raises
    ------
    FormatError
        If it is no such file, or newer than this version reads.
    """
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FormatError("does not exist", file=path) from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FormatError(f"is not JSON ({error})", file=path) from error
    if not isinstance(document, dict) or "products" not in document:
        raise FormatError("is not a stereo.json", file=path)
    try:
        return STEREO.migrated(document, path)
    except (KeyError, TypeError) as error:
        raise FormatError(f"lacks or garbles a value ({error})", file=path, field="products") from error


def read_products(path: Path) -> list[StereoProduct]:
    """All products of a stereo.json.

    Raises
    ------
    FormatError
        If the file is damaged, incomplete or newer.
    """
    document = read_document(path)
    try:
        return [_product_from_record(record, path.parent) for record in document["products"]]
    except (KeyError, TypeError, IndexError) as error:
        raise FormatError(f"lacks or garbles a value ({error})", file=path, field="products") from error


def _product_from_record(record: Record, folder: Path) -> StereoProduct:
    cameras = {name: rec.camera_from_record(r) for name, r in record["cameras"].items()}
    law = record["law"]
    written: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in record["options"].items()
    }
    options = RectifyOptions(**written)
    low, high = record["height_range"]
    job = RectifyJob(
        name=record["name"],
        frame=rec.frame_from_record(record["frame"], folder),
        tangent=rec.tangent_from_record(record["tangent"]),
        photographs=tuple(rec.photograph_from_record(r, cameras, folder) for r in record["photographs"]),
        reductions=tuple(record["reductions"]),
        heights=rec.height_model_from_record(record["height_model"], folder),
        centres_in_height_model=np.array(record["centres_in_height_model"]),
        grid=rec.grid_from_record(record["grid"]),
        models=tuple(rec.model_from_record(r) for r in record["models"]),
        law=ParallaxLaw("none", 1.0, 1.0) if law is None else law_from_record(law),
        height_range=(low, high),
        bands=tuple(band - 1 for band in record["bands"]),
        dtype=np.dtype(record["dtype"]),
        options=options,
        seams=seams_from_record(record["seams"]),
        balance=balance_from_record(record["balance"]),
    )
    files = record["files"]
    names = ProductFiles(files["ortho"], files["lineage"], files["mate"], record["sha256"])
    orientation = record["orientation_covariance"]
    known = None if orientation is None else OrientationCovariance.from_record(orientation)
    return StereoProduct(job, names, folder, record["height_model"]["sha256"], record["agreement"], known)


def _without_nan(value: Any) -> Any:
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, dict):
        return {k: _without_nan(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(v) for v in value]
    return value
