"""What was done in a window, step by step, as a script that does it again. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal_gui.models.step import CommandStep

SHELL = """#!/bin/sh
# What was done in lfcal's window, as commands. Files that exist are not replaced: remove them first, or add --force.
set -e
"""
PYTHON = '''"""What was done in lfcal's window."""

from pathlib import Path
'''


@dataclass(frozen=True)
class Taken:
    """A step that was taken.

    Attributes
    ----------
    page, title
        Key of its page, and its title there.
    step
        The step as a command and as Python, None if there is none.
    out
        The file or folder that it wrote, empty if none.
    why
        Why there is no command.
    draft
        Whether it saves nothing yet. The step of the same page that saves it replaces it.
    """

    page: str
    title: str
    step: CommandStep | None
    out: str = ""
    why: str = ""
    draft: bool = False


class History:
    """The steps of a sitting that ended well, in their order."""

    def __init__(self) -> None:
        self.taken: list[Taken] = []

    def add(self, taken: Taken) -> None:
        """Remember a step, in place of a draft of the same page."""
        drafts = [k for k, one in enumerate(self.taken) if one.draft and one.page == taken.page]
        if drafts:
            del self.taken[drafts[-1]]
        self.taken.append(taken)

    def latest(self, page: str) -> str:
        """Return the file or folder that a page wrote last, empty if none."""
        return next((one.out for one in reversed(self.taken) if one.page == page and one.out), "")

    def shell(self) -> str:
        """Return a script for a POSIX shell that ends at the first step that fails."""
        return SHELL + "".join(_commented(one, "" if one.step is None else one.step.shell()) for one in self.taken)

    def python(self) -> str:
        """Return a Python script with the same text for each step as when it is copied alone."""
        return PYTHON + "".join(_commented(one, "" if one.step is None else one.step.body()) for one in self.taken)


def _commented(taken: Taken, text: str) -> str:
    why = "" if taken.step is not None else f" (no command: {taken.why})"
    return f"\n# {' '.join(f'{taken.title}{why}'.split())}\n{text}"
