"""Notices above the frames, with remedies: a different orientation, and damaged frames."""

from __future__ import annotations

from collections.abc import Callable

from lfcal.frames import ORIENTATIONS
from lfcal.psf import FoundOrientation
from lfcal_gui.context import Context
from lfcal_gui.notice import UNCHANGED, Notice
from lfcal_gui.pages.frames.model import Opened
from lfcal_gui.pages.frames.orientation import advice, other_sensor

LEFT = "Use the frames as they are, and do not check their orientation. Undo (Ctrl+Z) reverts it"


class Noticed:
    """Show notices on the page and in the log.

    Parameters
    ----------
    context, notice
        Context and notice of the page.
    set_orientation
        Function that sets the orientation of the frames.
    """

    def __init__(self, context: Context, notice: Notice, set_orientation: Callable[[str], None]) -> None:
        self.context, self.notice, self._set = context, notice, set_orientation
        self._damage = ""
        """Text of the notice on a frame that cannot be read."""

    def offer_turn(self, opened: Opened | None, found: FoundOrientation | None, chosen: str, before: str = "") -> None:
        """Report the orientation of the frames if it is not the chosen one, and offer to turn them."""
        advised = None if found is None else advice(found, chosen)
        if advised is None and opened is not None:
            if words := other_sensor(opened.delivered.corrected, opened.plan):
                self._show_note(words)
        if advised is None:
            return
        said = advised.words
        words = f"{before}{said[0].lower()}{said[1:]}." if before else f"{said}."
        if advised.chosen:
            self._show_note(words)
            return
        self.context.message.emit(words)
        leave = (lambda: self._set(advised.leave)) if advised.leave else None
        if advised.apply:
            turns = advised.apply in ORIENTATIONS
            button = f"Turn upright ({advised.apply})" if turns else "Keep orientation"
            tip = "Turn all frames in this way" if turns else "Use the frames as they are"
            self.notice.offer(
                words,
                button,
                lambda: self._set(advised.apply),
                leave,
                tip=f"{tip}. Undo (Ctrl+Z) reverts it",
                stay_tip=LEFT if leave else UNCHANGED,
            )
        else:
            tip = "Open Set up, to correct the axes of the stage or the plan"
            self.notice.offer(
                words,
                "Plan",
                lambda: self.context.go.emit("setup", None),
                leave,
                tip=tip,
                stay_tip=LEFT if leave else UNCHANGED,
            )

    def _show_note(self, words: str) -> None:
        self.context.message.emit(words)
        self.notice.show_note(words)

    def tell_left_out(self, lines: tuple[str, ...]) -> None:
        """Report the frames that cannot be read and were left out, one line each."""
        for line in lines:
            self.context.message.emit(f"left out: {line}")
        if lines:
            count = "1 damaged frame is" if len(lines) == 1 else f"{len(lines)} damaged frames are"
            self.notice.show_note(f"{count} left out; the log says which, and why")

    def offer_without(self, words: str, leave_out: Callable[[], None]) -> None:
        """Offer to leave out damaged frames; ``words`` describe the damage of the frame that is shown."""
        tip = "Assemble H without the frames that cannot be read"
        self.notice.offer(words, "Leave out damaged frames", leave_out, tip=tip)
        self._damage = words

    def forget_damage(self) -> None:
        """Remove the notice on damage, because the current frame can be read."""
        if self._damage and self.notice.label.text() == self._damage:
            self.notice.clear()
        self._damage = ""
