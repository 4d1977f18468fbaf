"""History of the steps taken in a window, as a script that repeats them. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal_gui.models.step import CommandStep

SHELL = (
    "#!/bin/sh\n# Steps taken in the lfcal window, as commands. Existing files are not "
    "replaced: remove them first, or add --force.\nset -e\n"
)
PYTHON = '"""Steps taken in the lfcal window."""\n\nfrom pathlib import Path\n'


@dataclass(frozen=True)
class Taken:
    """A completed step.

    Attributes
    ----------
    page, title
        Key of its page, and title of the step.
    step
        The step as a command and as Python code; None if it has none.
    out
        File or folder that it wrote; empty if none.
    why
        Reason why it has no command.
    draft
        Whether its result is not saved yet. The step of the same page that saves it replaces this one.
    """

    page: str
    title: str
    step: CommandStep | None
    out: str = ""
    why: str = ""
    draft: bool = False


class History:
    """The successful steps since the window was opened, in their order."""

    def __init__(self) -> None:
        self.taken: list[Taken] = []

    def add(self, taken: Taken) -> None:
        """Add a step, replacing a draft of the same page."""
        drafts = [k for k, one in enumerate(self.taken) if one.draft and one.page == taken.page]
        if drafts:
            del self.taken[drafts[-1]]
        self.taken.append(taken)

    def latest(self, page: str) -> str:
        """Return the last file or folder that a page wrote; empty if none."""
        return next((one.out for one in reversed(self.taken) if one.page == page and one.out), "")

    def shell(self) -> str:
        """Return a POSIX shell script of all steps that stops at the first error."""
        return SHELL + "".join(_commented(one, "" if one.step is None else one.step.shell()) for one in self.taken)

    def python(self) -> str:
        """Return a Python script of all steps, with the same code for each step as a copy of that step."""
        return PYTHON + "".join(_commented(one, "" if one.step is None else one.step.body()) for one in self.taken)


def _commented(taken: Taken, text: str) -> str:
    why = "" if taken.step is not None else f" (no command: {taken.why})"
    return f"\n# {' '.join(f'{taken.title}{why}'.split())}\n{text}"
