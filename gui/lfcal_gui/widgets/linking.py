"""Pictures that are panned and zoomed together."""

from __future__ import annotations

from collections.abc import Sequence

import pyqtgraph as pg

from lfcal_gui.widgets.image_view import ImageView

__all__ = ["link_plots", "link_views"]


def link_views(views: Sequence[ImageView]) -> None:
    """Show the same part in all of ``views`` when the user moves one."""
    plots = [view.plot for view in views]
    link_plots(plots)
    for view in views:
        view.whole_shown.connect(lambda view=view: _follow(view.plot, plots))


def link_plots(plots: Sequence[pg.PlotItem]) -> None:
    """Show the same part in all of ``plots`` when the user moves one; pyqtgraph's own links drift apart."""
    for plot in plots:
        plot.vb.sigRangeChangedManually.connect(lambda *_, plot=plot: _follow(plot, plots))


def _follow(moved: pg.PlotItem, plots: Sequence[pg.PlotItem]) -> None:
    seen = moved.vb.viewRect()
    for plot in plots:
        if plot is not moved:
            plot.vb.setRange(seen, padding=0)
