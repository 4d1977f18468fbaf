"""Convert tasks to commands, Python and job files, and read job files."""

from __future__ import annotations

import dataclasses
import json
import shlex
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lfcal.base import FileFormatError, parse_json, read_text
from lfcal.records import OWN_SOLVERS, SolverFields, flat, from_flat, rows, rows_of, value_at
from lfcal.tasks.sets import task_set
from lfcal.tasks.task import RunSettings, Task

__all__ = ["command_of", "job_of", "load_job", "python_of", "read_job", "words_of"]


FACES = {
    "CorrectionRecipe": "lfcal.frames",
    "AssemblySettings": "lfcal.psf",
    **dict.fromkeys(
        ("BootstrapSettings", "LightFieldSettings", "ProjectionSettings", "VoxelGrid"), "lfcal.reconstruct"
    ),
    **{kind.__name__: "lfcal.reconstruct" for kind in OWN_SOLVERS},
}
"""Packages from which Python code imports the classes of records, by name of the class."""


def words_of(task: Task, run: RunSettings | None = None) -> tuple[str, ...]:
    """Return the arguments after ``lfcal`` of a command line that is equivalent to ``task`` with the settings ``run``.

    Values that equal the defaults are left out, except options that select the kind of task.
    """
    inputs, options = [], []
    for row, value in [(row, value_at(one, row)) for one in (task, run) if one for row in rows_of(one)]:
        if row.opt.argument:
            inputs += [str(one) for one in value] if row.many else [str(value)]
        elif (value != row.default or row.opt.chooses) and value is not None:
            texts = [row.text(one) for one in value] if row.many else [row.text(value)]
            options += (
                [row.flag if value or not row.off else row.off]
                if row.kind is bool
                else [f"{row.flag}={text}" for text in texts]
            )
    return (*task.name.split(), *inputs, *options)


def command_of(task: Task, run: RunSettings | None = None) -> str:
    """Return the command line that is equivalent to ``task``, with the settings ``run``.

    Examples
    --------
    >>> from lfcal.psf import AssemblySettings
    >>> from lfcal.tasks import Assemble, command_of
    >>> print(command_of(Assemble(frames="my frames", out="H.h5", settings=AssemblySettings(cutout=(41, 31)))))
    lfcal assemble 'my frames' --out=H.h5 --cutout=41,31
    """
    return shlex.join(("lfcal", *words_of(task, run)))


def python_of(task: Task, run: RunSettings | None = None, imported: Collection[str] = ()) -> str:
    """Return Python code that runs ``task`` with the settings ``run``.

    Imports from the modules named in ``imported`` are left out.

    Examples
    --------
    >>> from lfcal.tasks import Assemble, python_of
    >>> print(python_of(Assemble(frames="frames", out="H.h5")))
    from pathlib import Path
    from lfcal.tasks import Assemble
    <BLANKLINE>
    made = Assemble(
        frames=Path('frames'),
        out=Path('H.h5'),
    ).run()
    <BLANKLINE>
    """
    names: set[tuple[str, str]] = set()
    call, reported = _call(task, names, 0), ""
    if given := _reported(run):
        names.add(("lfcal.tasks", "RunSettings"))
        reported = f"RunSettings({', '.join(f'{name}={value!r}' for name, value in given.items())})"
    modules = {module for module, _ in names}.difference(imported)
    ordered = sorted(modules, key=lambda module: (module != "pathlib", module))
    imports = [f"from {m} import {', '.join(sorted(name for other, name in names if other == m))}" for m in ordered]
    return "\n".join([*imports, "", f"made = {call}.run({reported})", ""])


def _reported(run: RunSettings | None) -> dict[str, Any]:
    """Return the run settings that differ from the defaults."""
    every = dataclasses.fields(run) if run else ()
    return {one.name: value for one in every if (value := getattr(run, one.name)) != one.default}


def _call(whole: Any, names: set[tuple[str, str]], depth: int) -> str:
    kind = type(whole)
    # solvers of other packages have no class that could be imported
    foreign = isinstance(whole, SolverFields) and kind.__name__ not in FACES
    called = "solver_settings" if foreign else kind.__name__
    names.add((FACES.get(called, "lfcal.tasks"), called))
    given = [repr(whole.name)] if foreign else []
    for field in dataclasses.fields(whole):
        value = getattr(whole, field.name)
        if value != field.default:
            inner = dataclasses.is_dataclass(value)
            given.append(f"{field.name}={_call(value, names, depth + 1) if inner else _literal(value, names)}")
    end = "    " * depth
    inside = "".join(f"\n{end}    {one}," for one in given)
    return f"{called}({inside}\n{end})" if inside else f"{called}()"


def _literal(value: Any, names: set[tuple[str, str]]) -> str:
    if isinstance(value, tuple):
        return f"({', '.join(_literal(one, names) for one in value)}{',' * (len(value) == 1)})"
    if isinstance(value, Path):
        names.add(("pathlib", "Path"))
        return f"Path({str(value)!r})"
    return repr(value)


def job_of(task: Task, run: RunSettings | None = None) -> str:
    """Return the text of a job file (TOML) for ``task`` and ``run``; `load_job` reads such a file.

    It contains all values of the task that are not None, and the settings of the run that differ from the defaults.

    Examples
    --------
    >>> from lfcal.tasks import Assemble, job_of
    >>> print(job_of(Assemble(frames="frames", out="H.h5")).partition("[corrections]")[0])
    task = "assemble"
    frames = "frames"
    out = "H.h5"
    ...
    """
    data = task.to_dict()
    tables = {name: data.pop(name) for name in list(data) if isinstance(data[name], dict)}
    tables |= {"run": more} if (more := _reported(run)) else {}
    lines = [f"{name} = {_toml(value)}" for name, value in data.items() if value is not None]
    for title, table in tables.items():
        lines += ["", f"[{title}]", *(f"{name} = {_toml(v)}" for name, v in table.items() if v is not None)]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)  # JSON and TOML share numbers, texts, lists and booleans


def read_job(data: Mapping[str, Any], what: str, root: Path = Path()) -> tuple[Task, RunSettings]:
    """Return the task and the run settings that ``data`` describes: the entries of a job file or of a provenance.

    ``what`` is the name of the job in messages. Paths in ``data`` are relative to ``root``.

    Raises
    ------
    InputError, FileFormatError
        If the job names no task, or has entries or values that the task does not allow.
    """
    given = dict(data)
    if not isinstance(given.get("task"), str):
        raise FileFormatError.expected(
            f"{what}, task", 'a job with an entry such as task = "assemble"', "no such entry", "add the task"
        )
    tasks, reported = task_set(given.pop("task")), given.pop("run", {})
    # a field that several kinds have is read as the first kind declares it, as on the command line
    known = {row.path: row for kind in reversed(tasks.kinds) for row in rows(kind)}
    fields, values = {row.name: row for row in known.values()}, {}
    for name, value in flat(tuple(known.values()), given, "job", "fields of its task").items():
        placed = fields[name].placed(value, lambda path: root / path)
        # H stores a value for every field, so a default counts as not given
        if fields[name].opt.chooses or placed not in (None, fields[name].default):
            values[name] = placed
    run = from_flat(RunSettings, flat(rows(RunSettings), reported, "run"))
    return tasks.make(values, lambda name: ".".join(fields[name].path)), run


def _made_by(path: Path) -> Any:
    """Return the task that made an H or volume file, as stated in the file; None if it states none."""
    from lfcal.base.h5 import H5File
    from lfcal.psf import open_psf
    from lfcal.reconstruct import VOLUME_FORMAT

    with H5File(path) as file:
        if file.attributes().text("format", "") == VOLUME_FORMAT:
            details = parse_json(file.attributes().text("details", "{}"), str(path))
            return details.get("task") if isinstance(details, Mapping) else None
    with open_psf(path) as matrix:
        return matrix.provenance.get("task")


def load_job(path: Path, more: Mapping[str, Any] = MappingProxyType({})) -> tuple[Task, RunSettings]:
    """Return the task and run settings in a job file (.toml, .json), or those that made an H or volume file (.h5).

    Entries of ``more`` replace those of the job. Paths are relative to the folder of the file.

    Raises
    ------
    InputError, FileFormatError, StorageError
        If there is no such file, or it contains no job.
    """
    if path.suffix.lower() in (".h5", ".hdf5"):
        made = _made_by(path)
        if not isinstance(made, Mapping):
            raise FileFormatError.expected(
                str(path), "an H or a volume that was made by a task", "another one", "give a job file"
            )
        return read_job({**made, **more}, str(path), path.parent)
    text = read_text(path)
    if path.suffix.lower() == ".json":
        data = parse_json(text, str(path))
    else:
        try:
            data = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise FileFormatError.expected(str(path), "TOML", str(error), "correct the file") from None
    if not isinstance(data, Mapping):
        raise FileFormatError.expected(str(path), "a job", f"a {type(data).__name__}", "correct the file")
    return read_job({**data, **more}, str(path), path.parent)
