"""Tasks: frozen records of work to do. Commands, forms, job files, scripts and units are generated from them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Progress, Work, any_of, drain, note, plain
from lfcal.records import check_needs, check_record, from_flat, opt, record, rows, rows_of, to_dict, value_at

if TYPE_CHECKING:
    from lfcal.work import RunChoice

__all__ = ["RunSettings", "Task", "TaskResult", "TaskSet", "may_replace"]

UNITS = ("executor", "scheduler", "resume")
"""Fields of `RunSettings` that apply to work done in units."""

LONG = 60.0
"""Processor time (s) above which work is always done in units, so that stopping the process loses only one unit."""


def _executors() -> tuple[str, ...]:
    from lfcal.work import EXECUTORS

    return tuple(EXECUTORS.names())


@record
class RunSettings:
    """Settings of a run of a task, such as the number of threads; they do not change its result.

    Examples
    --------
    >>> from lfcal.tasks import Acquire, RunSettings, python_of
    >>> print(python_of(Acquire(plan="plan.json", out="session"), RunSettings(resume=True)).splitlines()[-1])
    ).run(RunSettings(resume=True))
    """

    workers: int | None = opt(
        None, "Number of threads or processes.", at_least=1, empty="LFCAL_WORKERS, else one per processor"
    )
    executor: str = opt(
        "",
        "Where to run the units of long work: in threads of this process, in processes, or with dask.",
        examples=_executors,
        empty="threads",
        more=True,
    )
    scheduler: str = opt("", "Address of a running dask scheduler.", empty="a local scheduler", more=True)
    resume: bool = opt(False, "Continue an earlier run that was stopped or interrupted.")
    force: bool = opt(False, "Replace existing files.")

    def choice(self, out: Path, seconds: float = 0.0, units: str = "plane by plane") -> RunChoice | None:
        """Return the settings for computing ``out`` in units; None if it is computed without units.

        Units are used if they are requested, if the work is long, or if an earlier run left a folder of units.

        Parameters
        ----------
        out
            File that the work writes.
        seconds
            Predicted CPU time (s).
        units
            Description of the units in messages.

        Raises
        ------
        InputError
            If the settings exclude each other, or an earlier run was not completed and neither ``resume`` nor
            ``force`` is set.
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
            note(
                f"intermediate results are kept in {folder.name} {units}; a stopped run can continue from "
                "them (--resume)"
            )
        return choice


def may_replace(out: Path, run: RunSettings) -> bool:
    """Return whether an existing ``out`` may be replaced: with ``force``, or if a resumed run had begun to write it."""
    from lfcal.work import was_joining

    return run.force or (run.resume and was_joining(out))


class TaskResult:
    """Base class of the results of tasks."""

    @property
    def failed(self) -> bool:
        """Whether the answer of the task is negative; its command then ends with exit code 1."""
        return False

    def exit_code(self) -> int:
        """Return the exit code of the command: 1 if ``failed``, otherwise 0."""
        return int(self.failed)

    def to_dict(self) -> dict[str, Any]:
        """Return a summary as plain JSON types."""
        found: dict[str, Any] = plain(self._values())
        return found

    def _values(self) -> dict[str, Any]:
        """Return the values of the summary by name; they may contain paths, arrays and dataclasses."""
        raise NotImplementedError

    def close(self) -> None:
        """Close the files of the result that are still open."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """Base class of all tasks. The result depends only on the fields of the task.

    Attributes
    ----------
    name
        Name of the command.
    input_words
        Description of the input or output that distinguishes the tasks of one command, such as ``"frames"`` or ``"H"``.
    in_units
        Whether the task can be done in units by other processes, and continued after a stop.
    resumes
        Whether the task can be continued after a stop although it is not done in units.
    """

    name: ClassVar[str]
    input_words: ClassVar[str] = ""
    in_units: ClassVar[bool] = False
    resumes: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Check every field, including those of nested records; convert texts, for example to paths."""
        for row in rows(type(self)):
            if len(row.path) == 1:
                object.__setattr__(self, row.name, row.value(value_at(self, row), row.name))
        check_record(self)

    def work(self, run: RunSettings | None = None) -> Work[tuple[TaskResult, ...]]:
        """Run the task, yielding progress, and return its results."""
        raise NotImplementedError

    def run(self, run: RunSettings | None = None, *, on_progress: Callable[[Progress], None] | None = None) -> Any:
        """Run the task, and return its results, a tuple of `TaskResult`.

        ``on_progress`` is called with each `Progress` record.
        """
        return drain(self.work(run), on_progress)

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``)."""
        given = [(row, value_at(self, row)) for row in rows_of(self) if row.opt.file == way]
        return tuple(path for row, value in given for path in row.paths_of(value))

    @classmethod
    def takes(cls, name: str) -> bool:
        """Return whether the field ``name`` of `RunSettings` applies to tasks of this class."""
        return cls.in_units or name not in UNITS or (name == "resume" and cls.resumes)

    def unit_outputs(self) -> tuple[Path, ...]:
        """Return the outputs next to which the units of a stopped run are stored; empty if the task has no units."""
        return self.files("out") if self.in_units else ()

    def to_dict(self, *, absolute: bool = False, outputs: bool = True) -> dict[str, Any]:
        """Return the task with all its fields as plain JSON types.

        Parameters
        ----------
        absolute
            Whether to make all paths absolute.
        outputs
            Whether to include the files to write.
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
    """The tasks of one command; the given values determine which of them is run.

    Attributes
    ----------
    name
        Name of the command.
    kinds
        Classes of the tasks, one for each kind of input or output.
    choose
        Function that returns the class for given values by field name; it may read files.
    example
        A command line to show in the help.
    help
        What the command does; empty: the docstring of the first kind.
    """

    name: str
    kinds: tuple[type[Task], ...]
    choose: Callable[[Mapping[str, Any]], type[Task]]
    example: str
    help: str = ""

    def make(self, given: Mapping[str, Any], called: Callable[[str], str]) -> Task:
        """Return the task with the ``given`` values by field name; ``called`` names a field in messages.

        Raises
        ------
        InputError
            If a value is given for a field that this task does not have, or a required field has no value. Also if a
            value is not allowed or would have no effect.
        """
        for row in rows(self.kinds[0]):
            # the choice of the kind may depend on these
            everywhere = all(row.name in {one.name for one in rows(kind)} for kind in self.kinds)
            if row.default is MISSING and everywhere and row.name not in given:
                raise InputError.expected(row.called, "a value", "none", "state this value")
        kind = self.choose(given)
        self.refuse(kind, given, called)
        names = {row.name: called(row.name) for row in rows(kind)}
        check_needs(rows(kind), given, lambda row: names[row.name])
        return from_flat(kind, given)

    def refuse(self, kind: type[Task], given: Iterable[str], called: Callable[[str], str] = str) -> None:
        """Raise `InputError` for the first name that is not a field of ``kind``.

        ``given`` contains the names; ``called`` returns the name of a field for messages.
        """
        known = {row.name for row in rows(kind)}
        for name in given:
            if name not in known:
                kinds = [one.input_words for one in self.kinds if name in {row.name for row in rows(one)}]
                raise InputError.expected(called(name), any_of(kinds), kind.input_words, f"leave {called(name)} out")
