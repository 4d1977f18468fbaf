"""Record > Folder: settings for corrections, positions and cutouts of the frames."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from PySide6.QtWidgets import QCheckBox, QLineEdit

from lfcal.base import InputError
from lfcal.frames import parse_origin
from lfcal.tasks import Assemble
from lfcal_gui.models import Field, check_of, fields_of, shown_of
from lfcal_gui.pages.frames.model import CORRECTIONS, HELD, FrameSettings
from lfcal_gui.pages.frames.orientation import CHOICES
from lfcal_gui.widgets import FoldedForm

DARK_TIP, WHITE_TIP = CORRECTIONS[0][2], CORRECTIONS[1][2]
READING = "Positions and orientation"

_READ = {one.key: replace(one, group=READING, optional=False, late=True) for one in fields_of(Assemble)}
FIELDS = (
    *(
        Field(key, title, kind="bool", tip=tip, group="Corrections", default=getattr(FrameSettings(), key))
        for key, title, tip in CORRECTIONS
    ),
    *(_READ[key] for key in ("pattern", "manifest")),
    replace(_READ["orientation"], kind="choice", choices=CHOICES, read=None),
    *(_READ[key] for key in ("origin", "skip_damaged")),
    *fields_of(Assemble, without=HELD),
)
_check = check_of(Assemble)


class FrameChoices(FoldedForm):
    """The settings of the frames: those of `FrameSettings`, and the other fields of `lfcal.tasks.Assemble`."""

    def __init__(self) -> None:
        tip = "Corrections, positions in names and lists, and all other settings of H"
        super().__init__((), FIELDS, "How the frames are read", tip, framed=True)
        self.check = _refusal
        self._dark = True

    def show_settings(self, settings: FrameSettings) -> None:
        """Show the settings; without a white image, the division by a white image is disabled."""
        own = vars(settings) | {"use_dark": settings.use_dark and self._dark}
        self.set_values({**shown_of(Assemble, settings.option_values), **own})
        self.set_enabled("use_white", bool(settings.white), f"{WHITE_TIP}; no white frames were found")

    def show_positions(self, words: str) -> None:
        """Show the source of the positions if no manifest is given."""
        manifest = self.editor("manifest")
        assert isinstance(manifest, QLineEdit)
        manifest.setPlaceholderText(words)

    def show_dark(self, words: str, *, wanted: bool) -> None:
        """Show the dark signal that is subtracted; without a dark frame or black level, the choice is disabled."""
        box, there = self.editor("use_dark"), bool(words) or not wanted
        assert isinstance(box, QCheckBox)
        self._dark = there
        self.set_defaults({"use_dark": there})
        self.set_values({"use_dark": wanted and there})
        found = (
            f"Currently subtracted: {words}" if words else "" if there else "No dark frame and no black level was found"
        )
        tip = f"{DARK_TIP}. {found}".rstrip(". ")
        self.set_enabled("use_dark", there, tip)
        box.setToolTip(tip)


def _refusal(key: str, value: Any) -> str:
    if not hasattr(FrameSettings, key):
        return _check(key, value)
    try:
        if key == "origin":
            parse_origin(value)
    except InputError as error:
        return str(error)
    return ""
