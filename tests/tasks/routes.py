"""The routes of a task: command, copied Python, job file."""

from __future__ import annotations

import contextlib
import shlex
from pathlib import Path
from typing import Any

import pytest

from lfcal.base import InputError, Work
from lfcal.tasks import Task, command_of, job_of, python_of
from tests.cli.conftest import Lfcal


def go_every_route(lfcal: Lfcal, task: Task, out: Path) -> list[Path]:
    """Do a task, whose output is ``out``, in each way; return what was written, that of the task itself first."""
    folder, made = out.parent, [out]

    def moved(text: str, route: str) -> str:
        made.append(folder / f"by_{route}{out.suffix}")
        return text.replace(str(out), str(made[-1]))

    for one in task.run():
        one.close()
    done = lfcal(*shlex.split(moved(command_of(task), "command"))[1:])
    assert done.code == 0, done.err
    exec(moved(python_of(task), "python"), {})
    (folder / "job.toml").write_text(moved(job_of(task), "job"))
    done = lfcal("run", folder / "job.toml")
    assert done.code == 0, done.err
    return made


class _RecordedError(InputError):
    """Raised in place of the work."""


def check_every_route(lfcal: Lfcal, patch: pytest.MonkeyPatch, task: Task, folder: Path) -> None:
    """Check that command, Python and job file make the same task, which is not run: for tasks that take long."""
    seen: list[Any] = []

    def work(self: Task, _: object) -> Work[tuple[()]]:
        seen.append(self)
        raise _RecordedError("recorded")
        yield

    with patch.context() as stubbed:
        stubbed.setattr(type(task), "work", work)
        lfcal(*shlex.split(command_of(task))[1:]).refused("recorded")
        with contextlib.suppress(_RecordedError):
            exec(python_of(task), {})
        (folder / "job.toml").write_text(job_of(task))
        lfcal("run", folder / "job.toml").refused("recorded")
    assert seen == [task] * 3
