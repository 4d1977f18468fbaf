"""What few look at: figures and search of Multiplexing, windows beside pictures, a picture that fills its page."""

from __future__ import annotations

from collections.abc import Iterator

from lfcal_gui.scenes.sample import open_sample
from lfcal_gui.scenes.stage import Capture, Stage
from lfcal_gui.widgets import toggle_in

__all__ = ["parts"]


def parts(stage: Stage) -> Iterator[Capture]:
    """Go through them with the sample session."""
    open_sample(stage)
    yield from _multiplexing(stage)
    yield from _pictures(stage)


def _multiplexing(stage: Stage) -> Iterator[Capture]:
    page = stage.page("multiplex")
    page.panel.tabs.setCurrentIndex(2)
    for figure, name in ((3, "3"), (5, "5"), (6, "6"), (7, "7"), (0, "map")):
        page._edited("figure", figure)
        stage.settle()
        stage.tidy()
        yield Capture(f"multiplex_figure_{name}")
    page.panel.tabs.setCurrentIndex(3)
    stage.settle()
    yield Capture("multiplex_search_empty")
    for sought in ("filters", "mask"):
        page._edited("sought", sought)
        page.searching.search()
        stage.done()
        stage.tidy()
        yield Capture(f"multiplex_search_{sought}")
    page.panel.tabs.setCurrentIndex(0)
    for family in ("mask", "both"):
        page._edited("family", family)
        page._edited("size", 5)
        stage.settle()
        stage.tidy()
        yield Capture(f"multiplex_{family}")
    page._edited("family", "cfa")


def _pictures(stage: Stage) -> Iterator[Capture]:
    page = stage.page("psf")
    measuring = page.panel.main_view.measure()
    stage.turn(40)
    yield Capture("dialog_measuring", measuring)
    measuring.close()
    apertures = page.panel.show_apertures()
    stage.turn()
    yield Capture("dialog_apertures", apertures)
    apertures.close()
    for key in ("psf", "frames"):
        page = stage.page(key)
        toggle_in(page)
        stage.settle()
        stage.tidy()
        yield Capture(f"{key}_enlarged")
        toggle_in(page)
        stage.turn()
