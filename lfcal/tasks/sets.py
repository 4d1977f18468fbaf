"""All tasks by the names of their commands."""

from __future__ import annotations

import importlib

from lfcal.base import InputError, any_of, choose
from lfcal.tasks.task import TaskSet

__all__ = ["TASKS", "task_set"]

TASKS = {
    "acquire": "lfcal.tasks.acquire:ACQUIRE",
    "assemble": "lfcal.tasks.assembly:ASSEMBLE",
    "export": "lfcal.tasks.export:EXPORT",
    "depth": "lfcal.tasks.depth:DEPTH",
    "inspect": "lfcal.tasks.inspect:INSPECT",
    "reduce": "lfcal.tasks.reduce:REDUCE",
    "transpose": "lfcal.tasks.transpose:TRANSPOSE",
    "reconstruct": "lfcal.tasks.reconstruct:RECONSTRUCT",
    "plan": "lfcal.tasks.plan:PLAN",
    "plan fit": "lfcal.tasks.plan_fit:PLAN_FIT",
    "plan target": "lfcal.tasks.plan_target:PLAN_TARGET",
    "fit": "lfcal.tasks.fit:FIT",
    "fit check": "lfcal.tasks.fit_check:FIT_CHECK",
    "fit frames": "lfcal.tasks.fit_frames:FIT_FRAMES",
    "fit object": "lfcal.tasks.fit_object:FIT_OBJECT",
    "fit validate": "lfcal.tasks.fit_validate:FIT_VALIDATE",
    "simulate": "lfcal.tasks.simulate:SIMULATE",
    "watch": "lfcal.tasks.watch:WATCH",
}
"""Module and name of each set of tasks, by the name of its command; modules are imported only when needed."""


def task_set(name: str) -> TaskSet:
    """Return the set of tasks of the command ``name``; raise `InputError` if the name is unknown."""
    if name not in TASKS:
        raise InputError.expected("task", any_of(TASKS), repr(name), choose(name, TASKS))
    module, _, attribute = TASKS[name].partition(":")
    found: TaskSet = getattr(importlib.import_module(module), attribute)
    return found
