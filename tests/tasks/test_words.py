"""Every field of every task is described for people: in the command, the form, the reference and Python."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys

import pytest

from lfcal.base import InputError
from lfcal.records import FieldRow, rows
from lfcal.tasks.sets import TASKS, task_set
from lfcal.tasks.task import RunSettings, Task

KINDS: dict[str, type] = {kind.__name__: kind for name in TASKS for kind in task_set(name).kinds}
KINDS["RunSettings"] = RunSettings
FIELDS: dict[str, FieldRow] = {f"{kind}.{row.name}": row for kind, one in KINDS.items() for row in rows(one)}


def test_a_field_is_described_in_sentences_without_options() -> None:
    """Readers in Python, a form or a job file know no options of a command line."""
    for name, row in FIELDS.items():
        assert row.opt.help.endswith(".") and row.opt.help[0] != " ", (name, row.opt.help)
        assert "--" not in row.opt.help + row.opt.empty + row.label, (name, "names of options")
        assert (len(row.opt.help) < 300 and row.label[0].isupper()) or row.label[0].isdigit(), name


def test_a_default_is_allowed() -> None:
    for name, row in FIELDS.items():
        if not isinstance(row.default, type(inspect.Parameter.empty)) and "MISSING" not in repr(row.default):
            row.check(row.default, name)
            for offered in row.offered:
                row.value([offered] if row.many else offered, name)


def test_every_kind_names_its_input_and_refuses_fields_of_others() -> None:
    refused = 0
    for name in TASKS:
        tasks = task_set(name)
        kinds = tasks.kinds
        assert len({kind.input_words for kind in kinds}) == len(kinds) and all(kind.name == name for kind in kinds)
        assert len(kinds) == 1 or all(kind.input_words for kind in kinds)
        assert tasks.example.startswith(f"lfcal {name} ")
        every = {row.name for kind in kinds for row in rows(kind)}
        for kind in kinds:
            for field in every - {row.name for row in rows(kind)}:
                with pytest.raises(InputError) as error:
                    tasks.refuse(kind, [field])
                said = str(error.value)
                assert said.startswith(f"{field}: expected ") and said.endswith(
                    f"got {kind.input_words}; leave {field} out"
                )
                refused += 1
    assert refused > 100


def test_help_in_python_has_every_field() -> None:
    for kind in (one for one in KINDS.values() if issubclass(one, Task)):
        said = inspect.getdoc(kind) or ""
        for row in rows(kind):
            if len(row.path) == 1:
                assert re.search(rf"^{row.name}$", said, re.MULTILINE), (kind, row.name)
        assert set(inspect.signature(kind).parameters) == {row.path[0] for row in rows(kind)}


def test_the_help_of_a_task_loads_nothing_heavy() -> None:
    """A record is made where nothing else is: for ``--help``, for completion, and where a job file is read."""
    code = "import importlib, sys; from lfcal.tasks.sets import TASKS, task_set; [task_set(name) for name in TASKS]; "
    code += "from lfcal.records import rows; [rows(kind) for name in TASKS for kind in task_set(name).kinds]; "
    code += "[importlib.import_module('lfcal.cli.' + name.replace(' ', '_')) for name in TASKS]; "
    code += "print(sorted({'numpy', 'h5py', 'lfcal.psf', 'lfcal.frames', 'lfcal.camera'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
