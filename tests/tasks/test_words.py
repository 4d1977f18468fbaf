"""Every field of every task is described for people: in the command, the form, the reference and Python."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys

import pytest

from lfcal.records import FieldRow, rows
from lfcal.tasks.sets import TASKS, task_set
from lfcal.tasks.task import RunSettings, Task

KINDS: dict[str, type] = {kind.__name__: kind for name in TASKS for kind in task_set(name).kinds}
KINDS["RunSettings"] = RunSettings
FIELDS: dict[str, FieldRow] = {f"{kind}.{row.name}": row for kind, one in KINDS.items() for row in rows(one)}


@pytest.mark.parametrize("name", FIELDS)
def test_a_field_is_described_in_sentences_without_options(name: str) -> None:
    """Who reads it in Python, a form or a job file knows no options of a command line."""
    row = FIELDS[name]
    assert row.opt.help.endswith(".") and row.opt.help[0] != " ", row.opt.help
    assert "--" not in row.opt.help + row.opt.empty + row.label, "names of options"
    assert (len(row.opt.help) < 300 and row.label[0].isupper()) or row.label[0].isdigit()


@pytest.mark.parametrize("name", FIELDS)
def test_a_default_is_allowed(name: str) -> None:
    row = FIELDS[name]
    if not isinstance(row.default, type(inspect.Parameter.empty)) and "MISSING" not in repr(row.default):
        row.check(row.default, name)
        for offered in row.offered:
            row.value([offered] if row.many else offered, name)


@pytest.mark.parametrize("name", TASKS)
def test_every_kind_says_what_its_input_is(name: str) -> None:
    kinds = task_set(name).kinds
    assert len({kind.input_words for kind in kinds}) == len(kinds) and all(kind.name == name for kind in kinds)
    assert len(kinds) == 1 or all(kind.input_words for kind in kinds)
    assert task_set(name).example.startswith(f"lfcal {name} ")


@pytest.mark.parametrize("kind", [one for one in KINDS.values() if issubclass(one, Task)])
def test_help_in_python_has_every_field(kind: type) -> None:
    said = inspect.getdoc(kind) or ""
    for row in rows(kind):
        if len(row.path) == 1:
            assert re.search(rf"^{row.name}$", said, re.MULTILINE), row.name
    assert set(inspect.signature(kind).parameters) == {row.path[0] for row in rows(kind)}


def test_the_help_of_a_task_loads_nothing_heavy() -> None:
    """A record is made where nothing else is: for ``--help``, for completion, and where a job file is read."""
    code = "import importlib, sys; from lfcal.tasks.sets import TASKS, task_set; [task_set(name) for name in TASKS]; "
    code += "from lfcal.records import rows; [rows(kind) for name in TASKS for kind in task_set(name).kinds]; "
    code += "[importlib.import_module('lfcal.cli.' + name.replace(' ', '_')) for name in TASKS]; "
    code += "print(sorted({'numpy', 'h5py', 'lfcal.psf', 'lfcal.frames', 'lfcal.camera'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
