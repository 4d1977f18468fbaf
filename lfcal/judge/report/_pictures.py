"""The pictures of a quality report, as PNG in memory."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.base import LINES, draw_image, figure, format_plane, html_figure
from lfcal.judge.comparison import Comparison
from lfcal.judge.inspection import Inspection
from lfcal.judge.quality import Metric, QualityReport
from lfcal.judge.telling import drawn
from lfcal.psf import PSFMatrix, depth_sum
from lfcal.psf.aperture import KINDS, Aperture, expected_aperture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PICTURES", "ReportPicture", "pictures"]

PICTURES = (
    "depth_sums.png",
    "transposed_sum.png",
    "over_depth.png",
    "slices.png",
    "tiling.png",
    "against_reference.png",
    "shifts.png",
)
"""Names of the pictures a report may have, in addition to ``map_METRIC.png``."""

PANELS = 12
"""Number of planes shown of a deep H, evenly spaced."""

PANEL = 3.05
"""Width of a panel with its colour bar (inches)."""


@dataclass(frozen=True, slots=True)
class ReportPicture:
    """A picture of the report: its section, file name and caption."""

    section: str
    name: str
    caption: str
    png: bytes = field(repr=False)


def fault_pictures(inspection: Inspection) -> list[ReportPicture]:
    """Return the pictures that show faults."""
    return [
        ReportPicture("faults", one.title, f"{one.title}: {one.picture.title}.", drawn(one.picture))
        for one in inspection.faults
        if one.picture is not None
    ]


def figures(pictures: Sequence[ReportPicture], section: str) -> str:
    """Return the pictures of a section as HTML."""
    return "".join(html_figure(one.png, one.caption) for one in pictures if one.section == section)


def pictures(
    H: PSFMatrix, quality: QualityReport, reference: PSFMatrix | None, comparison: Comparison | None
) -> list[Callable[[], ReportPicture]]:
    """Return the functions that draw the pictures, in the order of the page."""
    draw: list[Callable[[], ReportPicture]] = [
        lambda: _depth_sums(H, quality),
        lambda: _transposed_sum(H),
        lambda: _over_depth(quality),
        lambda: _slices(H),
    ]
    shown = [m for m in quality.metrics if m.map is not None and m.merit in ("bad", "fair")]
    shown += [m for m in quality.metrics if m.map is not None and m.spec.always_shown and m not in shown]
    draw += [lambda m=m: _metric_map(m, quality) for m in shown]  # type: ignore[misc]
    if any(t is not None for t in quality.tilings):
        draw.append(lambda: _tiling(quality))
    if reference is not None and comparison is not None:
        draw += [lambda: _against(H, reference), lambda: _shifts(H, comparison)]
    return draw


class _Sheet:
    """A figure that is converted to PNG at the end of its block."""

    def __init__(self, fig: Figure) -> None:
        self.fig = fig
        self.png = b""

    def grid(self, n: int, columns: int) -> Iterator[Axes]:
        """Yield ``n`` axes in rows of ``columns``."""
        rows = -(-n // columns)
        for k in range(n):
            yield self.fig.add_subplot(rows, columns, k + 1)


@contextmanager
def _sheet(columns: int, height: float) -> Iterator[_Sheet]:
    with figure(columns * PANEL, height) as fig:
        sheet = _Sheet(fig)
        yield sheet
        buffer = io.BytesIO()
        fig.savefig(buffer, format="png")
        sheet.png = buffer.getvalue()


def chosen(n: int, most: int) -> list[int]:
    """Return at most ``most`` of ``n`` planes, including the first and the last."""
    return sorted({round(k) for k in np.linspace(0, n - 1, min(n, most))})


def _row_height(shape: tuple[int, int]) -> float:
    """Return the height of a row of images of ``shape`` with their titles and labels (inches)."""
    return min(max((PANEL - 1.2) * shape[0] / shape[1], 0.7) + 0.8, 3.6)


def _columns(n: int) -> tuple[int, int]:
    """Return columns and rows of a sheet of ``n`` images."""
    return min(n, 3), -(-n // 3)


def _depth(depths: NDArray[np.float64], z: int) -> str:
    return format_plane(float(depths[z]), z, "z")


def _depth_sums(H: PSFMatrix, quality: QualityReport) -> ReportPicture:
    planes = chosen(len(H), PANELS)
    columns, rows = _columns(len(planes))
    with _sheet(columns, rows * _row_height(H.cutout)) as sheet:
        for z, axes in zip(planes, sheet.grid(len(planes), columns), strict=True):
            aperture = quality.apertures[z]
            words = _shape(aperture)
            shown, unit = _unspoilt(H.depth_sum(z))
            draw_image(axes, shown, title=f"{_depth(quality.depths, z)}: {words}", unit=f"sum of H{unit}")
            expected = _expected(H, z)
            if expected is not None:
                line = expected.outline()
                axes.plot(np.r_[line[:, 1], line[0, 1]], np.r_[line[:, 0], line[0, 0]], "--", color=LINES[2], lw=1.0)
            if aperture.seen:
                line = aperture.outline()
                style = "-" if aperture.confident else ":"
                axes.plot(np.r_[line[:, 1], line[0, 1]], np.r_[line[:, 0], line[0, 0]], style, color="white", lw=1.3)
                corners = aperture.vertices() if aperture.confident else np.empty((0, 2))
                axes.plot(corners[:, 1], corners[:, 0], "o", color=LINES[1], ms=3.5)
    text = "Depth-plane sums: the aperture seen from each depth, with the fitted iris (dotted if uncertain)"
    if H.camera is not None:
        text += " and the iris expected from the camera's description (dashed)"
    return ReportPicture("aperture", "depth_sums.png", f"{text}{_of(len(planes), len(H))}.", sheet.png)


def _expected(H: PSFMatrix, z: int) -> Aperture | None:
    if H.camera is None:
        return None
    return expected_aperture(H.camera, float(H.depths[z]), H.cutout, H.pixel_scale)


def _shape(aperture: Aperture) -> str:
    """Return a short description of an aperture's shape."""
    if not aperture.confident:
        return aperture.refusal or "unknown"
    return f"{aperture.blades} blades" if aperture.kind in ("polygon", "rounded polygon") else KINDS[aperture.kind]


def _of(shown: int, there: int) -> str:
    return "" if shown == there else f"; {shown} of {there} planes"


def _unspoilt(image: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    """Return the image with hot pixels clipped to the level of the other pixels, and a note if there were any."""
    level = 1.5 * float(np.nanpercentile(image, 99)) if np.isfinite(image).any() else 0.0
    if level <= 0 or not np.nanmax(image) > level:
        return image, ""
    return np.minimum(image, level), ", hot pixels clipped"


def _transposed_sum(H: PSFMatrix) -> ReportPicture:
    """Draw the sum of the transposed plane, computed from HT itself."""
    z = len(H) // 2
    straight = np.nan_to_num(H.depth_sum(z))
    turned = np.nan_to_num(depth_sum(H.T.plane(z)))[::-1, ::-1]
    apart = (turned - straight) / (np.abs(straight).max() or 1.0)
    with _sheet(2, _row_height(H.cutout)) as sheet:
        left, right = sheet.grid(2, 2)
        draw_image(left, turned, title=f"HT rotated by 180°, {_depth(H.known_depths, z)}", unit="sum of HT")
        draw_image(right, apart, title="difference from H", unit="of peak", signed=True)
        # rounding alone must not fill the range of colours
        top = max(float(np.abs(apart).max()), 1e-6)
        right.images[0].set_clim(-top, top)
    caption = "The sum of the transposed matrix must equal that of H rotated by 180°; the largest difference is "
    return ReportPicture(
        "aperture", "transposed_sum.png", f"{caption}{np.abs(apart).max():.2g} of the peak.", sheet.png
    )


def _over_depth(quality: QualityReport) -> ReportPicture:
    depths, label = quality.depths, "depth z (µm)"
    if not quality.extent:
        depths, label = np.arange(depths.size, dtype=np.float64), "plane"
    elif np.abs(depths).max() >= 1e3:
        depths, label = depths / 1e3, "depth z (mm)"
    sizes = np.array([a.diameter_px if a.seen else np.nan for a in quality.apertures])
    curves = (
        (sizes, "aperture diameter (px)"),
        (quality.energy, "median energy of a pattern"),
        (quality.peak / np.where(quality.noise > 0, quality.noise, np.nan), "peak-to-noise ratio"),
    )
    with _sheet(3, 2.5) as sheet:
        for (values, name), axes in zip(curves, sheet.grid(3, 3), strict=True):
            axes.plot(depths, values, "o-", color=LINES[0], ms=4)
            axes.set_xlabel(label)
            axes.set_ylabel(name)
            axes.ticklabel_format(useOffset=False, axis="y", scilimits=(-3, 5))
            top = np.nanmax(values, initial=0.0)
            axes.set_ylim(0, 1.15 * top if top > 0 else 1)
    return ReportPicture("aperture", "over_depth.png", "Size, energy and signal as functions of depth.", sheet.png)


def _slices(H: PSFMatrix) -> ReportPicture:
    planes = chosen(len(H), 3)
    y, x = (n // 2 for n in H.period)
    with _sheet(2, len(planes) * _row_height(H.cutout)) as sheet:
        grid = sheet.grid(2 * len(planes), 2)
        for z in planes:
            draw_image(next(grid), H[z, y, x], title=f"H: point at {_depth(H.known_depths, z)}", unit="value")
            draw_image(
                next(grid),
                H.T[z, y, x],
                title=f"HT: voxels of one pixel, {_depth(H.known_depths, z)}",
                unit="value",
                xlabel="voxel column s (px)",
                ylabel="voxel row t (px)",
            )
    caption = (
        f"Slices at position y {y}, x {x}: the pixels that a point illuminates, and the voxels that illuminate a pixel."
    )
    return ReportPicture("slices", "slices.png", caption, sheet.png)


def _metric_map(metric: Metric, quality: QualityReport) -> ReportPicture:
    if metric.map is None:
        raise ValueError("expected a metric with a map, got one without")
    planes = chosen(len(metric.map), PANELS)
    if len(metric.positions):  # planes in which positions are named come first
        counts = np.bincount(metric.positions[:, 0], minlength=len(metric.map))
        named = np.argsort(-counts, kind="stable")[: min(PANELS, np.count_nonzero(counts))]
        planes = sorted(set(named.tolist()) | set(planes[: PANELS - len(named)]))
    columns, rows = _columns(len(planes))
    low, high = _range(metric)
    with _sheet(columns, rows * _row_height(quality.shape[1:3])) as sheet:
        for z, axes in zip(planes, sheet.grid(len(planes), columns), strict=True):
            where, unit = _depth(quality.depths, z), metric.spec.map_unit or metric.spec.unit
            _positions_map(axes, metric.map[z], where, unit, signed=low < 0)
            axes.images[0].set_clim(low, high)
            here = metric.positions[metric.positions[:, 0] == z]
            axes.plot(here[:, 2], here[:, 1], "s", mfc="none", mec=LINES[1], ms=6, mew=1.2)
    marked = "  Squares mark the named positions." if len(metric.positions) else ""
    words = f"{metric.spec.title} ({metric.text}, {metric.merit}). {metric.spec.meaning}{marked}"
    return ReportPicture("maps", f"map_{metric.key}.png", f"{words}{_of(len(planes), len(metric.map))}", sheet.png)


def _range(metric: Metric) -> tuple[float, float]:
    """Return the common range of the maps of all planes: symmetric about zero for values with a sign."""
    known = np.zeros(0) if metric.map is None else metric.map[np.isfinite(metric.map)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if low < 0:
        high = max(-low, high)
        return -high, high
    return (low, high) if high > low else (0.0, high or 1.0)


def _positions_map(axes: Axes, values: NDArray[np.floating], title: str, unit: str, *, signed: bool = False) -> None:
    axes.set_facecolor("#d1d5db")
    draw_image(axes, values, title=title, unit=unit, xlabel="position x (px)", ylabel="position y (px)", signed=signed)


def _tiling(quality: QualityReport) -> ReportPicture:
    """Draw the control frames at their positions: difference from the cell, and distance of the best fit."""
    known = [(z, t) for z, t in enumerate(quality.tilings) if t is not None]
    shown = [known[k] for k in chosen(len(known), 4)]
    with _sheet(2, len(shown) * 2.7) as sheet:
        grid = sheet.grid(2 * len(shown), 2)
        for z, tiling in shown:
            rows, columns = tiling.positions.T
            for values, unit in (
                (100 * tiling.difference, "difference (%)"),
                (np.hypot(*tiling.shift.T), "distance of the best fit (px)"),
            ):
                axes = next(grid)
                dots = axes.scatter(columns, rows, c=values, s=60, edgecolor="white", linewidth=0.6, vmin=0, zorder=3)
                axes.invert_yaxis()
                axes.set_aspect("equal", adjustable="datalim")
                axes.set_title(_depth(quality.depths, z))
                axes.set_xlabel("sensor column (px)")
                axes.set_ylabel("sensor row (px)")
                sheet.fig.colorbar(dots, ax=axes, shrink=0.85).set_label(unit)
    text = (
        "Control frames over the field: difference from the same position of the period, and distance of "
        "the position that"
    )
    return ReportPicture("tiling", "tiling.png", f"{text} fits best{_of(len(shown), len(known))}.", sheet.png)


def _against(H: PSFMatrix, reference: PSFMatrix) -> ReportPicture:
    """Draw the middle position of each plane next to the same position of the reference, at equal energy."""
    planes = chosen(len(H), 3)
    y, x = (n // 2 for n in H.period)
    with _sheet(3, len(planes) * _row_height(H.cutout)) as sheet:
        grid = sheet.grid(3 * len(planes), 3)
        for z in planes:
            ours, theirs = (np.asarray(m[z, y, x], float) for m in (H, reference))
            energy = float(ours.sum())
            scaled = ours * (float(theirs.sum()) / energy) if energy else ours
            draw_image(next(grid), scaled, title=f"H, {_depth(H.known_depths, z)}", unit="at the reference's energy")
            draw_image(next(grid), theirs, title="reference", unit="value")
            draw_image(next(grid), scaled - theirs, title="difference", unit="value", signed=True)
    return ReportPicture(
        "comparison", "against_reference.png", f"Position y {y}, x {x} of H and of the reference.", sheet.png
    )


def _shifts(H: PSFMatrix, comparison: Comparison) -> ReportPicture:
    planes = chosen(len(H), 4)
    with _sheet(3, len(planes) * _row_height(H.period)) as sheet:
        grid = sheet.grid(3 * len(planes), 3)
        for z in planes:
            where = _depth(H.known_depths, z)
            _positions_map(next(grid), 100 * comparison.error[z], f"error, {where}", "% (L2)")
            _positions_map(next(grid), comparison.shift_px[z, ..., 0], "shift of the centroid, rows", "px", signed=True)
            _positions_map(next(grid), comparison.shift_px[z, ..., 1], "columns", "px", signed=True)
    text = "Error at equal energy and centroid shift over positions (grey: not compared)"
    return ReportPicture("comparison", "shifts.png", f"{text}{_of(len(planes), len(H))}.", sheet.png)
