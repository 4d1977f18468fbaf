"""Export by the window, its copied command and its copied Python: the same file, and every choice of the task."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.psf import PSFMatrix, save
from lfcal.records import rows, value_at
from lfcal_gui.models.opening import OpeningSettings
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.psf.export_model import CHOICES, KINDS, ExportIntent, export_task, iter_exported
from lfcal_gui.pages.psf.step import step
from tests.cli import conftest
from tests.tasks.routes import Lfcal
from tests.tasks.test_matrices import contents

lfcal = conftest.lfcal
BY_HAND = {"region", "mat_order"}
"""Fields that no choice of the export sets: which region of the file, and how it was opened; see `test_page`."""


def with_everything() -> Iterator[ExportIntent]:
    """Yield an intent of each format with every choice made the other way."""
    for suffix, _ in KINDS:
        intent = ExportIntent(suffix=suffix, position=(2, 1))
        names = [choice.name for choice in CHOICES if suffix in choice.suffixes]
        turned: dict[str, Any] = {name: not getattr(intent, name) for name in names}
        yield replace(intent, **turned)


@pytest.mark.parametrize("intent", tuple(with_everything()), ids=lambda intent: intent.suffix)
def test_window_command_and_python_write_the_same_file(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, intent: ExportIntent
) -> None:
    monkeypatch.chdir(tmp_path)
    values = np.random.default_rng(0).random((2, 3, 3, 5, 7), np.float32)
    save(PSFMatrix(values, depths=(-5.0, 5.0)), "H.h5")
    intent = replace(intent, lens_centred=False, moved=False)  # H states no camera
    copied = step(ProjectState(psf="H.h5"), f"out{intent.suffix}", intent)
    path = drain(iter_exported("H.h5", intent, f"out{intent.suffix}"))
    by_window = contents(path)
    path.unlink()
    done = lfcal(*shlex.split(copied.shell())[1:])
    assert done.code == 0, done.err
    assert contents(path) == by_window
    path.unlink()
    exec(compile(copied.script(), "script", "exec"), {})
    assert contents(path) == by_window


def test_the_window_sets_every_field_of_an_export() -> None:
    for intent in with_everything():
        task = export_task("H.h5", f"out{intent.suffix}", intent)
        default = {row.name for row in rows(type(task)) if value_at(task, row) == row.default}
        assert default == BY_HAND, type(task).__name__


def test_the_command_names_the_order_of_axes_that_was_stated() -> None:
    project = ProjectState(psf="H.mat")
    assert "--mat-order=rows-first" not in step(project).arguments
    project = replace(project, settings=OpeningSettings().with_order("H.mat", "rows-first").into(project))
    assert "--mat-order=rows-first" in step(project).arguments
    assert "--mat-order=rows-first" not in step(replace(project, psf="other.mat")).arguments


def test_a_script_imports_nothing_twice() -> None:
    script = step(ProjectState(psf="H.h5")).script()
    assert script.count("from pathlib import Path") == 1 and "ExportMat(" in script
