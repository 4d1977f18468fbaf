"""Loss if the H of one region is used for the whole field: every region is compared with the first."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Work, drained, figure, save_figure
from lfcal.judge.comparison import iter_compare
from lfcal.psf import open_psf, regions_of

__all__ = ["RegionLoss", "draw_region_loss", "iter_region_loss", "region_loss"]


@dataclass(frozen=True, slots=True, eq=False)
class RegionLoss:
    """Differences of the patterns of ``n`` regions from those of the first region at the same positions.

    Attributes
    ----------
    names
        Names of the regions, including the first.
    anchors
        Sensor position (row, column) of position (0, 0) of each region, ``(n, 2)`` (pixels).
    error
        ``|a / s - b| / |b|`` (L2) of each pattern, ``(n, nz, ny, nx)``; NaN if not compared. Here a is the pattern, and
        b the pattern of the first region at the same position. The factor s makes their sums equal.
    shift_px
        Root mean square of the shifts of the centroids from those of the first region, ``(n,)`` (pixels).
    """

    names: tuple[str, ...]
    anchors: NDArray[np.float64]
    error: NDArray[np.float32]
    shift_px: NDArray[np.float64]

    @property
    def losses(self) -> NDArray[np.float64]:
        """Root mean square of the error of each region ``(n,)``, 0 for the first; NaN if nothing was compared."""
        squares = self.error.astype(np.float64).reshape(len(self.names), -1) ** 2
        known = np.isfinite(squares).any(axis=1)
        found = np.full(len(self.names), np.nan)
        found[known] = np.sqrt(np.nanmean(squares[known], axis=1))
        return found

    @property
    def worst(self) -> float:
        """Largest of the ``losses``."""
        return float(np.nanmax(self.losses))

    def to_dict(self) -> dict[str, object]:
        """Return the name, anchor, loss and shift of each region and the largest loss as plain JSON types."""
        rows = zip(self.names, self.anchors.tolist(), self.losses.tolist(), self.shift_px.tolist(), strict=True)
        regions = [{"region": n, "anchor": a, "loss": e, "shift_px": s} for n, a, e, s in rows]
        return {"worst": self.worst, "regions": regions}


def iter_region_loss(path: str | os.PathLike[str], *, workers: int | None = None) -> Work[RegionLoss]:
    """Compare the regions of an H file with the first region, which is the default one.

    Raises
    ------
    InputError
        If the file has only one region, or the shapes of its regions differ.
    """
    names = regions_of(path)
    if len(names) < 2:
        raise InputError.expected(
            str(path),
            "H of several regions of the field",
            "H of one region",
            "record several regions (lfcal plan --regions)",
        )
    errors, anchors, shifts = [], [], []
    with open_psf(path) as first:
        for k, name in enumerate(names):
            with open_psf(path, region=name) as own:
                anchors.append(own.anchor)
                if k == 0:
                    errors.append(np.where(own.recorded > 0, 0.0, np.nan).astype(np.float32))
                    shifts.append(0.0)
                    continue
                found = yield from iter_compare(own, first, by_index=True, workers=workers)
                errors.append(found.error)
                shifts.append(found.rms_shift_px)
    return RegionLoss(tuple(names), np.array(anchors), np.stack(errors), np.array(shifts))


region_loss = drained(iter_region_loss)


def draw_region_loss(loss: RegionLoss, path: Path) -> None:
    """Write a figure with a map over positions of the error of each region (rms over planes) to the file ``path``.

    The maps are arranged like the regions on the sensor.
    """
    rows, columns = (np.unique(np.round(loss.anchors[:, k] / 8) * 8) for k in (0, 1))
    high = max(float(np.nanmax(loss.error)), 1e-6)
    with figure(2.2 * len(columns) + 1.0, 1.9 * len(rows) + 0.6) as fig:
        grid = fig.subplots(len(rows), len(columns), squeeze=False)
        for axes in grid.ravel():
            axes.set_axis_off()
        image = None
        for k, name in enumerate(loss.names):
            row = int(np.argmin(np.abs(rows - loss.anchors[k, 0])))
            column = int(np.argmin(np.abs(columns - loss.anchors[k, 1])))
            axes = grid[row, column]
            with np.errstate(invalid="ignore"):
                values = 100 * np.sqrt(np.nanmean(loss.error[k].astype(np.float64) ** 2, axis=0))
            image = axes.imshow(values, vmin=0, vmax=100 * high, cmap="viridis", interpolation="nearest")
            axes.set_title(f"{name}: {100 * loss.losses[k]:.3g} %", fontsize=8)
        assert image is not None
        fig.colorbar(image, ax=list(grid.ravel()), label="difference from the first region (%)", shrink=0.8)
        save_figure(fig, path)
