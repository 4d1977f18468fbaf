"""Pictures that are panned and zoomed together."""

from __future__ import annotations

from collections.abc import Sequence

from gui.widgets.image_view import ImageView

__all__ = ["link_views"]


def link_views(views: Sequence[ImageView]) -> None:
    """Show the same part in all of ``views`` when the user moves one; pyqtgraph's own links drift apart."""
    for view in views:
        view.plot.vb.sigRangeChangedManually.connect(lambda *_, view=view: _follow(view, views))
        view.whole_shown.connect(lambda view=view: _follow(view, views))


def _follow(moved: ImageView, views: Sequence[ImageView]) -> None:
    seen = moved.plot.vb.viewRect()
    for view in views:
        if view is not moved:
            view.plot.vb.setRange(seen, padding=0)
