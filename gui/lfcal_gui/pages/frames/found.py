"""Summary of the opened frames: whether they are complete and upright, and the facts. No Qt."""

from __future__ import annotations

from pathlib import Path

from lfcal.psf import FoundOrientation
from lfcal_gui.pages.frames.model import Opened
from lfcal_gui.pages.frames.orientation import advice


def understood(opened: Opened, found: FoundOrientation | None, chosen: str) -> tuple[str, str, str]:
    """Return a mark (``"good"``, ``"fair"``, ``"bad"`` or none), a headline and a sentence.

    ``found`` is the orientation found for the frames, None while it is not known; ``chosen`` is the user's choice.
    """
    if found is None:
        return "", "Looking at the frames …", "Their orientation is being compared with the plan."
    if (turn := advice(found, chosen)) is not None and not turn.chosen:
        return "bad", "The frames are not oriented as in the plan", f"{turn.words}."
    if opened.left_out:
        return "fair", "Some frames are damaged", f"{len(opened.left_out)} cannot be read and are left out of H."
    if opened.missing:
        return "fair", "Some positions have no frame", f"{opened.missing} of {opened.frames.size} are missing."
    if not found.name:
        return "fair", "Every position has a frame", f"The orientation of the frames is unclear: {found.reason}."
    return "good", "All of it is understood", "Every position has a frame, and their orientation is that of the plan."


def facts_of(opened: Opened) -> tuple[tuple[str, str, str], ...]:
    """Return rows of name, number and remark about the frames."""
    nz, ny, nx = opened.frames.shape
    rows, columns = opened.view.shape
    chosen = opened.chosen
    white = ("applied" if chosen.use_white else "not applied") if chosen.white else ""
    return (
        ("Frames", f"{len(opened.source):,}", f"{columns} × {rows} px"),
        ("Positions", f"{nx} × {ny}", f"in {nz} plane{'' if nz == 1 else 's'}"),
        ("Missing", f"{opened.missing:,}", ""),
        ("Taken off", "", opened.dark or "nothing"),
        ("White frames", "", f"{Path(chosen.white).name}, {white}" if white else "none"),
        ("Positions from", "", Path(chosen.manifest).name or opened.positions),
    )
