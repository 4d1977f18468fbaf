"""Export by the window, its copied command and its copied Python: the same file, and every choice of the task."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.psf import PSFMatrix, save
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.settings import OpeningSettings
from lfcal_gui.pages.reconstruct.export_model import KINDS, ExportSettings, iter_exported
from lfcal_gui.pages.reconstruct.step import export_step, step
from tests.cli import conftest
from tests.gui.pages.reconstruct.test_export_model import turned
from tests.tasks.routes import Lfcal
from tests.tasks.test_matrices import contents

lfcal = conftest.lfcal


@pytest.mark.parametrize("suffix", KINDS)
def test_window_command_and_python_write_the_same_file(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    settings = turned(suffix).changed("lens_centred", False)  # H states no camera
    same_everywhere(lfcal, tmp_path, monkeypatch, settings, "")


@pytest.mark.parametrize("code", ["olaf", "prevedel", "pyolaf"])
def test_window_command_and_python_write_the_same_for_a_code(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str
) -> None:
    same_everywhere(lfcal, tmp_path, monkeypatch, ExportSettings(), code)


def same_everywhere(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, settings: ExportSettings, code: str
) -> None:
    monkeypatch.chdir(tmp_path)
    values = np.random.default_rng(0).random((2, 3, 3, 5, 7), np.float32)
    save(PSFMatrix(values, depths=(-5.0, 5.0)), "H.h5")
    out = f"out{settings.suffix_for(code)}"
    copied = export_step(ProjectState(psf="H.h5"), out, settings, code)
    path = drain(iter_exported(settings.task("H.h5", out, code=code), out))
    by_window = written(path)
    path.unlink()
    done = lfcal(*shlex.split(copied.shell())[1:])
    assert done.code == 0, done.err
    assert written(path) == by_window
    path.unlink()
    exec(compile(copied.script(), "script", "exec"), {})
    assert written(path) == by_window


def written(path: Path) -> Any:
    """Return the values of a file, without the addresses of cells and the dates of a zip file."""
    if path.suffix != ".npz":
        found = contents(path)
        cells = path.suffix == ".mat" and any(name.startswith("#refs#") for name in found)
        return {name: value for name, value in found.items() if name not in ("H", "Ht")} if cells else found
    with np.load(path) as file:
        return {name: file[name].tobytes() for name in file.files}


def test_the_command_names_the_order_of_axes_that_was_stated() -> None:
    project = ProjectState(psf="H.mat")
    assert "--mat-order=rows-first" not in step(project).arguments
    project = replace(project, settings=OpeningSettings().with_order("H.mat", "rows-first").into(project))
    assert "--mat-order=rows-first" in step(project).arguments
    assert "--mat-order=rows-first" not in step(replace(project, psf="other.mat")).arguments


def test_a_script_imports_nothing_twice() -> None:
    script = step(ProjectState(psf="H.h5")).script()
    assert script.count("from pathlib import Path") == 1 and "ExportMat(" in script
