"""A new window: the welcome, and every page with nothing in it."""

from __future__ import annotations

from collections.abc import Iterator

from lfcal_gui.scenes.stage import Shot, Stage

__all__ = ["empty"]


def empty(stage: Stage) -> Iterator[Shot]:
    """Show the welcome and the empty pages."""
    window = stage.window
    welcome = window.tools.welcome()
    stage.turn()
    yield Shot("welcome", welcome)
    welcome.close()
    for spec in window.specs:
        stage.page(spec.key)
        stage.tidy()
        yield Shot(f"{spec.key}_empty")
