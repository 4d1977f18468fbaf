"""A new window: the welcome, and every page with nothing in it."""

from __future__ import annotations

from collections.abc import Iterator

from lfcal_gui.scenes.stage import Capture, Stage

__all__ = ["empty"]


def empty(stage: Stage) -> Iterator[Capture]:
    """Show the welcome and the empty pages."""
    window = stage.window
    welcome = window.tools.welcome()
    stage.turn()
    yield Capture("welcome", welcome)
    welcome.close()
    for spec in window.specs:
        stage.page(spec.key)
        stage.tidy()
        yield Capture(f"{spec.key}_empty")
