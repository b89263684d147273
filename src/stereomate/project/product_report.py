"""What a report says of a product: pictures, law, seams, measured parallaxes, each with its numbers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np

from stereomate.parallax.laws import LawKind, ParallaxLaw
from stereomate.project.mosaic_report import SEAMS_CAPTION, mosaic_texts, seam_steps_table, seams_table
from stereomate.project.run import ProductResult
from stereomate.rectify.job import RectifyJob
from stereomate.rectify.layout import StereoModel
from stereomate.rectify.seam_steps import measured_seam_steps
from stereomate.report.page import Picture, Section, Table
from stereomate.report.run_figures import law_figure, residual_figure, svg_uri
from stereomate.report.seams import seams_figure
from stereomate.report.stereo_pictures import detail_anaglyph, jpeg_uri, product_pictures
from stereomate.stereo.agreement import Agreement
from stereomate.stereo.model_quality import quality_of_agreement
from stereomate.stereo.product import StereoProduct

OTHER_LAWS: Final[tuple[LawKind, ...]] = ("linear", "logarithmic", "natural")
# Rows of the tables behind the figures of the law and of the matches.
_LAW_ROWS: Final = 9
_MOST_MATCHES: Final = 250


def product_section(out: Path, made: ProductResult) -> Section:
    """Pictures, law, seams and measured parallaxes of one product."""
    job, files = made.product.job, made.product.files
    middle = float(job.law.q(0.5 * sum(job.height_range))) / job.grid.gsd
    pictures = product_pictures(out, files.ortho, files.mate, middle)
    shown = [
        Picture(
            jpeg_uri(pictures["ortho"]),
            f"{files.ortho}: for the left eye.",
            "Orthophoto",
            _raster_table(out, made, files.ortho),
        )
    ]
    paragraphs = [_grid_text(job)]
    tables = []
    if files.mate is not None:
        shown.append(
            Picture(
                jpeg_uri(pictures["mate"]),
                f"{files.mate}: for the right eye.",
                "Stereomate",
                _raster_table(out, made, files.mate),
            )
        )
        shown.append(
            Picture(
                jpeg_uri(pictures["anaglyph"]),
                "Anaglyph of the whole product, middle heights at the screen: red glass left, cyan right.",
                "Anaglyph of the product",
                _screen_table(job),
                wide=True,
            )
        )
        paragraphs.append(_law_text(job))
        shown.append(
            Picture(
                svg_uri(law_figure(job)),
                "Parallax laws over the heights of the product.",
                "Laws",
                _law_table(job),
            )
        )
    if made.mosaic is not None:
        paragraphs += mosaic_texts(made.mosaic, job)
        if job.seams is not None:
            figure = svg_uri(seams_figure(job, pictures["ortho"]))
            shown.append(Picture(figure, SEAMS_CAPTION, "Seams", seams_table(job)))
            mate = None if files.mate is None else out / files.mate
            steps = measured_seam_steps(job, out / files.ortho, mate, out / files.lineage)
            if steps:
                tables.append(seam_steps_table(steps))
    if made.agreement is not None and files.mate is not None:
        tables.append(_agreement_table(made.agreement))
        tables += _model_tables(made.product, made.agreement)
        shown += _agreement_pictures(out, made, made.agreement)
    title = "Product" if not job.name else f"Product {job.name}"
    return Section(title, tuple(paragraphs), tuple(tables), tuple(shown))


def _grid_text(job: RectifyJob) -> str:
    turned = math.degrees(job.grid.rotation)
    direction = "north-up" if turned == 0.0 else f"rows turned by {-turned:+.3f}° along the base"
    text = f"Grid {direction}, origin on whole GSDs; {job.options.resampling} resampling, "
    return text + f"{job.options.heights_interpolation} heights, hidden ground: {job.options.hidden}."


def _law_text(job: RectifyJob) -> str:
    law = job.law
    y = max((_object_y_parallax(job, m) for m in job.models if m.right >= 0 and m.penalty < 0.7), default=0.0)
    q_low, q_high = (float(q) / job.grid.gsd for q in law.q(list(job.height_range)))
    return (
        f"{law.kind.capitalize()} law with nominal base {law.base_m:.2f} m, w0 {law.w0_m:.2f} m above the "
        f"reference level {law.reference_m:.2f} m: parallaxes of {q_low:.1f} to {q_high:.1f} pixels. "
        f"An object {job.options.object_height_m:g} m high shows at most {y:.2f} pixels of y-parallax."
    )


def _object_y_parallax(job: RectifyJob, model: StereoModel) -> float:
    """y-parallax in pixels that an object of the declared height shows in a model (`rectify.layout`)."""
    height = job.options.object_height_m
    depth = model.height_above_ground_m - height
    if depth <= 0.0:
        return math.inf
    return abs(model.base_v_m) * height / depth / job.frame.unit_m / job.grid.gsd


def _agreement_table(agreement: Agreement) -> Table:
    rows = []
    for name, s in (
        ("orthophoto left against orthophoto right", agreement.ortho_ortho),
        ("orthophoto against stereomate, minus q(h)", agreement.ortho_mate),
    ):
        if s.count:
            cells = [_with_error(*v) for v in zip(s.median_px, s.standard_error_px, strict=True)]
            cells += [f"{v:.3f}" for v in s.nmad_px]
            cells += [f"{v:.2f}" for v in s.largest_px]
        else:
            cells = ["–"] * 6
        rows.append((name, str(s.count), *cells))
    headings = ("pixels", "matches", "median x", "median y", "nmad x", "nmad y", "largest x", "largest y")
    said = (
        "Measured by image matching on a sample of windows; left minus right. ± is the standard error of the "
        "median: neighbours share the error of the height model, so whole blocks are drawn anew for it."
    )
    return Table(headings, tuple(rows), said)


# Models with fewer matches are not judged.
_FEW_MATCHES = 10


def _model_tables(product: StereoProduct, agreement: Agreement) -> list[Table]:
    """How well the rays of each model meet."""
    rows = [
        (
            f"{m.left} – {m.right}",
            str(m.count),
            *(f"{v:+.3f}" for v in (m.miss_median_m, m.y_median_m)),
            *(f"{v:.3f}" for v in (m.miss_rms_m, m.y_rms_m)),
        )
        for m in quality_of_agreement(product, agreement)
        if m.count >= _FEW_MATCHES
    ]
    headings = ("model, metres", "matches", "median miss", "median y", "rms miss", "rms y")
    said = (
        "Shortest distance of the rays of matched points after lineage: the quality of the orientation, "
        "whatever the height model. The y-parallax in the product beside it also holds the error of the "
        "height model."
    )
    return [Table(headings, tuple(rows), said)] if rows else []


def _with_error(median: float, error: float) -> str:
    return f"{median:+.3f}" if math.isnan(error) else f"{median:+.3f} ± {error:.3f}"


def _agreement_pictures(out: Path, made: ProductResult, agreement: Agreement) -> list[Picture]:
    if not len(agreement.residuals):
        return []
    job, files = made.product.job, made.product.files
    assert files.mate is not None
    figure = svg_uri(residual_figure(agreement))
    pixels = job.grid.pixel_from_map(agreement.points)
    middle = int(np.argmin(np.hypot(*(pixels - np.median(pixels, axis=0)).T)))
    detail = detail_anaglyph(
        out,
        files.ortho,
        files.mate,
        (float(pixels[middle, 0]), float(pixels[middle, 1])),
        agreement.parallaxes[middle],
    )
    return [
        Picture(
            figure,
            "Measured parallaxes of the matches, the law's share taken off.",
            "Residual parallaxes",
            _match_table(agreement),
        ),
        Picture(
            jpeg_uri(detail),
            "Anaglyph of a detail at full resolution.",
            "Anaglyph of a detail",
            Table(
                ("middle of the detail", "value"),
                (
                    ("easting, northing", "{:.2f}, {:.2f}".format(*agreement.points[middle])),
                    ("parallax at the screen, pixels", f"{agreement.parallaxes[middle]:.2f}"),
                ),
            ),
        ),
    ]


def _raster_table(out: Path, made: ProductResult, name: str) -> Table:
    job = made.product.job
    cols, rows = job.grid.size
    return Table(
        ("raster", name),
        (
            ("columns, rows", f"{cols}, {rows}"),
            ("GSD", f"{job.grid.gsd:g}"),
            ("pixels", f"{job.dtype}, {len(job.bands)} bands"),
            ("bytes", str((out / name).stat().st_size)),
            ("SHA-256", made.product.files.hashes.get(name, "")),
        ),
    )


def _screen_table(job: RectifyJob) -> Table:
    low, high = job.height_range
    rows = tuple(
        (label, f"{h:.2f}", f"{float(job.law.q(h)) / job.grid.gsd:.2f}")
        for label, h in (
            ("lowest ground", low),
            ("at the screen", 0.5 * (low + high)),
            ("highest ground", high),
        )
    )
    return Table(("", "height", "parallax, pixels"), rows)


def _law_table(job: RectifyJob) -> Table:
    laws = [ParallaxLaw(kind, job.law.base_m, job.law.w0_m, job.law.reference_m) for kind in OTHER_LAWS]
    laws = [job.law, *(law for law in laws if law.kind != job.law.kind)]
    rows = tuple(
        (f"{h:.2f}", *(f"{float(law.q(h)) / job.grid.gsd:.3f}" for law in laws))
        for h in np.linspace(*job.height_range, _LAW_ROWS)
    )
    return Table(("height", *(f"{law.kind}, pixels" for law in laws)), rows)


def _match_table(agreement: Agreement) -> Table:
    every = -(-len(agreement.residuals) // _MOST_MATCHES)
    rows = tuple(
        (f"{x:.2f}", f"{y:.2f}", f"{dx:+.3f}", f"{dy:+.3f}")
        for (x, y), (dx, dy) in zip(agreement.points[::every], agreement.residuals[::every], strict=True)
    )
    kept = "All matches" if every == 1 else f"Every {every}th of {len(agreement.residuals)} matches"
    return Table(("easting", "northing", "x minus q(h), pixels", "y, pixels"), rows, kept)
