"""Dialogs and docks over the sample session."""

from __future__ import annotations

from collections.abc import Iterator

from lfcal.base import sample_session
from lfcal_gui.palette import Palette, doable
from lfcal_gui.scenes.sample import open_sample
from lfcal_gui.scenes.stage import Capture, Stage

__all__ = ["dialogs"]


def dialogs(stage: Stage) -> Iterator[Capture]:
    """Open one after the other."""
    window = stage.window
    open_sample(stage)
    page = stage.page("frames")
    page.start_import(str(sample_session() / "frames"))
    stage.settle()
    yield Capture("dialog_import", page.dialog)
    page.dialog.close()
    page = stage.page("setup")
    page.measure_sensor()
    stage.settle()
    yield Capture("dialog_sensor", page.dialog)
    page.dialog.close()
    for name in ("preferences", "doctor", "verify"):
        dialog = getattr(window.tools, name)()
        stage.settle()
        yield Capture(f"dialog_{name}", dialog)
        dialog.close()
    palette = Palette(window, doable(window.menuBar(), window.shown, "Set up"))
    palette.open()
    stage.turn()
    yield Capture("dialog_palette", palette)
    palette.close()
    window.show_manual("faults.md")
    stage.settle()
    yield Capture("dialog_manual", window._manual)
    window._manual.close()
