"""Step of a page as a command and as Python code, without the window. No Qt."""

from __future__ import annotations

import importlib
import importlib.util
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal_gui.models.page import PageSpec
from lfcal_gui.models.project import ProjectState

if TYPE_CHECKING:
    from lfcal.tasks import RunSettings, Task

CAMERA_FILE = "lfcal-camera.json"
PLAN_FILE = "lfcal-plan.json"
END = "LFCAL_END"


@dataclass(frozen=True)
class CommandStep:
    """One step of the work.

    Attributes
    ----------
    arguments
        Arguments of the command line, after ``lfcal``.
    python
        Equivalent Python code; it may assume that ``Path`` is imported.
    files
        Pairs of name and text: small input files of the command and of the Python code, which are written first.
    """

    arguments: tuple[str, ...]
    python: str
    files: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, task: Task, files: tuple[tuple[str, str], ...] = (), run: RunSettings | None = None) -> CommandStep:
        """Return the step that runs a task."""
        from lfcal.tasks import python_of, words_of

        return cls(words_of(task, run), python_of(task, run, imported=("pathlib",)), files)

    def shell(self) -> str:
        """Return the step as lines for a POSIX shell."""
        texts = [f"cat > {shlex.quote(name)} <<'{END}'\n{text}\n{END}\n" for name, text in self.files]
        return "".join(texts) + shlex.join(("lfcal", *self.arguments)) + "\n"

    def script(self) -> str:
        """Return the step as a Python script."""
        return "from pathlib import Path\n\n" + self.body()

    def body(self) -> str:
        """Return the Python code after the import of ``Path``."""
        texts = [f"Path({name!r}).write_text({text!r}, encoding='utf-8')\n" for name, text in self.files]
        return "".join(texts) + self.python.strip("\n") + "\n"


def step_of(spec: PageSpec, project: ProjectState, out: str = "", part: str = "") -> CommandStep:
    """Return the step of a page for the current project, from the function ``step`` of its module ``step``.

    ``out`` is the file or folder that it writes; empty: one with a name such as ``H.h5``. A ``part`` of the page has
    a module with its name, such as ``step_fit``.

    Raises
    ------
    InputError
        If the page has no command, or the project lacks what it needs.
    """
    module = f"{spec.package}.step" + (f"_{part}" if part else "")
    if importlib.util.find_spec(module) is None:
        raise InputError(f"{spec.title}: only possible with the buttons of this page")
    found: CommandStep = importlib.import_module(module).step(project, out)
    return found


def list_beside(path: str | Path) -> Path:
    """Return the path of the list of positions next to the plan file ``path``."""
    return Path(path).with_name(f"{Path(path).stem}_positions.json")


def options_of(pairs: Iterable[tuple[str, Any]]) -> tuple[str, ...]:
    """Return command-line options. None, False and empty values are omitted; True adds the option without a value."""
    found: list[str] = []
    for name, value in pairs:
        if value is True:
            found.append(name)
        elif value is not None and value is not False and value != "":
            found.append(f"{name}={value}")  # a value may start with a minus sign
    return tuple(found)


def needed_plan(project: ProjectState) -> ScanPlan:
    """Return the plan of the project; raise `InputError` if there is none."""
    if project.plan is None:
        raise InputError.expected("scan plan", "one", "none", "make or open one in Set up")
    return project.plan


def needed_file(path: str, what: str, where: str) -> str:
    """Return ``path``; raise `InputError` if it is empty."""
    if not path:
        raise InputError.expected(what, "one", "none", f"open one on the page {where}")
    return path
