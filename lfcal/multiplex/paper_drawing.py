"""The paper's figures as PNG: pictures with shared scales, a line of numbers under each (matplotlib, when drawn)."""

from __future__ import annotations

import os

from lfcal.base import draw_image, figure, save_figure
from lfcal.multiplex.paper import PaperFigure, PaperPanel

__all__ = ["save_paper_figure"]


def save_paper_figure(found: PaperFigure, path: str | os.PathLike[str]) -> None:
    """Write the pictures of a figure; figure 6 is `lfcal.multiplex.drawing.save_gain_curves`."""
    rows = -(-len(found.panels) // found.columns)
    with figure(3.7 * found.columns, 3.5 * rows + 0.4, dpi=140) as fig:
        grid = fig.subplots(rows, found.columns, squeeze=False).ravel()
        for axes, panel in zip(grid, found.panels, strict=False):
            _draw(axes, panel)
        for axes in grid[len(found.panels) :]:
            axes.set_axis_off()
        fig.suptitle(f"Figure {found.number}. {found.title}", fontsize=10)
        save_figure(fig, path)


def _draw(axes: object, panel: PaperPanel) -> None:
    from matplotlib.axes import Axes

    assert isinstance(axes, Axes)
    words = f"column\n{panel.numbers}"
    if panel.levels is None:
        axes.imshow(panel.image, interpolation="nearest")
        axes.grid(False)
        axes.set(title=panel.title, xlabel=words, ylabel="row")
        return
    draw_image(axes, panel.image, title=panel.title, unit="", xlabel=words, ylabel="row")
    axes.images[0].set_clim(*panel.levels)
