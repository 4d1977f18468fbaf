"""The public names of `lfcal.tasks`: each is loaded when it is asked for."""

from __future__ import annotations

from lfcal.tasks.assemble import Assemble, AssembleRegions, AssembleTarget
from lfcal.tasks.text import command_of, job_of, python_of

__all__ = [
    "Assemble",
    "AssembleRegions",
    "AssembleTarget",
    "command_of",
    "job_of",
    "python_of",
]
