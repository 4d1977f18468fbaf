"""Tasks: frozen records of what to do, from which command, form, job file, script and units are made."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work, drain, note
from lfcal.records import check_needs, check_record, from_flat, opt, record, rows, rows_of, to_dict, value_at

if TYPE_CHECKING:
    from lfcal.work import RunChoice

__all__ = ["RunSettings", "Task", "TaskResult", "TaskSet", "may_replace"]

UNITS = ("executor", "scheduler", "resume")
"""Fields of `RunSettings` that apply to work that is done in units."""

LONG = 60.0
"""Work that takes more seconds of processor time is always done in units: a kill loses one of them."""


def _executors() -> tuple[str, ...]:
    from lfcal.work import EXECUTORS

    return tuple(EXECUTORS.names())


@record
class RunSettings:
    """By whom a task is done, and what becomes of what is there: nothing of it changes the result.

    Examples
    --------
    >>> from lfcal.tasks import Acquire, RunSettings, python_of
    >>> print(python_of(Acquire(plan="plan.json", out="session"), RunSettings(resume=True)).splitlines()[-1])
    ).run(RunSettings(resume=True))
    """

    workers: int | None = opt(
        None, "Number of threads or processes.", at_least=1, empty="LFCAL_WORKERS, or every processor"
    )
    executor: str = opt(
        "",
        "What does the work: threads of this process, processes, or dask. Any of them does long work in units.",
        examples=_executors,
        empty="threads",
        more=True,
    )
    scheduler: str = opt("", "Address of a running scheduler, for the executor dask.", empty="a local one", more=True)
    resume: bool = opt(False, "Continue what an earlier run left after it was stopped or killed.")
    force: bool = opt(False, "Replace existing files.")

    def choice(self, out: Path, seconds: float = 0.0, units: str = "plane by plane") -> RunChoice | None:
        """Return how ``out`` is made in units, or None if the work is short and units were not asked for.

        Parameters
        ----------
        out
            What the work makes.
        seconds
            That it takes by forecast (processor time).
        units
            What the units are, for people.

        Raises
        ------
        InputError
            If these do not go together, or an earlier run left something and nothing says what becomes of it.
        """
        from lfcal.work import RunChoice, check_begun, parts_folder

        folder = parts_folder(out)
        asked = bool(self.executor or self.scheduler or self.resume)
        begun = "resume" if self.resume else "discard" if self.force else "refuse"
        executor = self.executor or ("dask" if self.scheduler else "threads")
        choice = RunChoice(executor, self.workers, self.scheduler, begun)
        check_begun(folder, resume=begun != "refuse")
        if not (asked or seconds > LONG or folder.exists()):
            return None
        if not asked and seconds > LONG:
            note(f"kept {units} in {folder.name}: --resume continues after a stop")
        return choice


def may_replace(out: Path, run: RunSettings) -> bool:
    """Return whether what is at ``out`` may be replaced: by ``force``, or as an earlier run began to write it."""
    from lfcal.work import was_joining

    return run.force or (run.resume and was_joining(out))


class TaskResult:
    """Base of what tasks make."""

    @property
    def failed(self) -> bool:
        """Whether it answers the question of the task with no; a command then ends with exit code 1."""
        return False

    def exit_code(self) -> int:
        """Return the exit code of a command that has shown it; raises what ended the work after that."""
        return int(self.failed)

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        raise NotImplementedError

    def close(self) -> None:
        """Close the files that are still open; by default there are none."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """Base of all tasks: the fields of a task are all that decides what comes of it.

    Attributes
    ----------
    name
        Of the command.
    input_words
        What its input is, or what it makes, where other kinds of the same command have others.
    in_units
        Whether other processes can do parts of it, and a run that was stopped continues.
    resumes
        Whether a run that was stopped continues, although it is not done in units.
    """

    name: ClassVar[str]
    input_words: ClassVar[str] = ""
    in_units: ClassVar[bool] = False
    resumes: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Check every field, and those of the records within; a text is taken as a path."""
        for row in rows(type(self)):
            if len(row.path) == 1:
                object.__setattr__(self, row.name, row.value(value_at(self, row), row.name))
        check_record(self)

    def work(self, run: RunSettings | None = None) -> Work[tuple[TaskResult, ...]]:
        """Do it; yields progress, and returns what was made."""
        raise NotImplementedError

    def run(self, run: RunSettings | None = None) -> Any:
        """Do it, and return what was made."""
        return drain(self.work(run))

    def files(self, way: str) -> tuple[Path, ...]:
        """Return its files: ``"in"`` or ``"out"``."""
        given = [(row, value_at(self, row)) for row in rows_of(self) if row.opt.file == way]
        return tuple(path for row, value in given for path in row.paths_of(value))

    @classmethod
    def takes(cls, name: str) -> bool:
        """Return whether a field of `RunSettings` applies to tasks of this kind."""
        return cls.in_units or name not in UNITS or (name == "resume" and cls.resumes)

    def unit_outputs(self) -> tuple[Path, ...]:
        """Return the outputs next to which units of a stopped run are kept."""
        return self.files("out") if self.in_units else ()

    def to_dict(self, *, absolute: bool = False, outputs: bool = True) -> dict[str, Any]:
        """Return it as plain JSON types, every field of it: a job, provenance, or what travels to another process.

        Parameters
        ----------
        absolute
            Make all paths absolute.
        outputs
            Name the files to write, too.
        """
        found = {"task": self.name, **to_dict(self)}
        for row in rows_of(self):
            value, place = value_at(self, row), found
            for name in row.path[:-1]:
                place = place[name]
            if row.opt.file == "out" and not outputs:
                del place[row.name]
            elif absolute and row.paths_of(value):
                placed = row.placed(value, os.path.abspath)
                place[row.name] = list(map(str, placed)) if isinstance(placed, tuple) else str(placed)
        return found


@dataclass(frozen=True)
class TaskSet:
    """The kinds of a task, of which the input decides.

    Attributes
    ----------
    name
        Of the command.
    kinds
        A class for each kind of input.
    choose
        Returns the kind of values by name; it may look at files.
    example
        A command line, for the help.
    help
        What the command does; empty: what the first kind says.
    """

    name: str
    kinds: tuple[type[Task], ...]
    choose: Callable[[Mapping[str, Any]], type[Task]]
    example: str
    help: str = ""

    def make(self, given: Mapping[str, Any], called: Callable[[str], str]) -> Task:
        """Return the task of ``given`` values by the names of their fields; ``called`` names a field in messages.

        Raises
        ------
        InputError
            For a value of a field that this kind of task does not have, or that it must have.
        """
        for row in rows(self.kinds[0]):
            # of these the choice may depend
            everywhere = all(row.name in {one.name for one in rows(kind)} for kind in self.kinds)
            if row.default is MISSING and everywhere and row.name not in given:
                raise InputError.expected(row.called, "a value", "none", "give it")
        kind = self.choose(given)
        self.refuse(kind, given, called)
        names = {row.name: called(row.name) for row in rows(kind)}
        check_needs(rows(kind), given, lambda row: names[row.name])
        return from_flat(kind, given)

    def refuse(self, kind: type[Task], given: Iterable[str], called: Callable[[str], str] = str) -> None:
        """Raise `InputError` for the first name that is no field of ``kind``."""
        known = {row.name for row in rows(kind)}
        for name in given:
            if name not in known:
                kinds = [one.input_words for one in self.kinds if name in {row.name for row in rows(one)}]
                raise InputError.expected(called(name), " or ".join(kinds), kind.input_words, "leave it out")
