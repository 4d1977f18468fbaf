"""Import problems for the dialog: options of the command line are replaced by the boxes of the dialog. No Qt."""

from __future__ import annotations

from lfcal_gui.models import said_in_window

BOXES = (
    ("--manifest", "choose the List above"),
    ("--columns", "choose it above its column"),
    ("--pattern", "type the pattern of Names above"),
    ("--order", "choose their Order above"),
    ("--first", "choose above what Positions count from"),
    ("--channel", "choose a colour above"),
    ("--orientation", "choose what makes them upright above"),
    ("--origin", "state their First pixel in Record > Folder, once they are open"),
    ("name it as", "choose their Dataset above"),
    ("lfcal plan", "choose the camera, or make the plan of the scan, in Set up"),
)
"""Options of the command line that messages name, and what does the same in the window."""


def said_in_dialog(problem: str) -> str:
    """Return ``problem`` without its command-line options, and with the remedy in the dialog."""
    *ways, last = [words for option, words in BOXES if option in problem] or [""]
    words = f"{', '.join(ways)}, or {last}" if ways else last
    return "; ".join(filter(None, (said_in_window(problem), words)))
