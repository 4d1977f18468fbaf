"""Inspection by the window, its copied command and its copied Python: the same report."""

from __future__ import annotations

import math
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base import InputError, drain
from lfcal.psf import PSFMatrix, save
from lfcal.records import rows
from lfcal.tasks import Inspect
from lfcal_gui.models import CompareRequest, OpeningSettings, ProjectState, compare_step, stamp_of
from lfcal_gui.pages.h.model_checks import (
    FIELDS,
    HELD,
    InspectionRun,
    QualitySettings,
    asked_of,
    iter_judge,
    iter_write_report,
)
from lfcal_gui.pages.h.step_checks import step
from tests.cli import conftest
from tests.cli._building import alike
from tests.judge.plain_report import undrawn
from tests.psf.test_mat_import import save_v73
from tests.tasks.routes import Lfcal
from tests.tasks.test_inspect import measured

lfcal = conftest.lfcal


def test_every_route_writes_the_same_report(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    monkeypatch.chdir(tmp_path)
    axes = np.mgrid[:15, :15] - 7.0
    spot = 100 * np.exp(-0.5 * (axes**2).sum(0) / 2.5**2)
    save(PSFMatrix(spot + np.random.default_rng(5).random((2, 3, 3, 15, 15))), "H.h5")
    chosen = QualitySettings(seconds=20.0)
    project = ProjectState(psf="H.h5", settings={"quality": chosen.to_dict()})
    kept, stamp = InspectionRun(), stamp_of("H.h5")
    assert stamp is not None
    drain(iter_judge(asked_of(stamp, chosen, None), kept))
    drain(iter_write_report("H.h5", "by_window", kept.inspection))
    done = lfcal(*shlex.split(step(project, "by_command").shell())[1:])
    assert done.code == 0, done.err
    exec(compile(step(project, "by_python").script(), "script", "exec"), {})
    for folder in ("by_command", "by_python"):
        assert alike(measured(Path(folder)), measured(Path("by_window"))), folder


def test_every_field_is_in_the_form_or_elsewhere_in_the_window() -> None:
    """``mat_order`` belongs to opening H, ``strict`` to the exit code of a command."""
    in_form = {field.key for field in FIELDS} - {"camera"}
    assert in_form | HELD == {row.name for row in rows(Inspect)} and not in_form & HELD


def test_choices_are_in_the_command_where_they_have_an_effect() -> None:
    chosen = QualitySettings(patterns=24, session="session")
    for seconds, more in ((600.0, ["--patterns=24"]), (0.0, [])):
        settings = {"quality": replace(chosen, seconds=seconds).to_dict()}
        copied = step(ProjectState(psf="H.h5", settings=settings)).arguments
        assert [word for word in copied if word.startswith("--pat")] == more and "--session=session" in copied
    for name, value in (("patterns", 0), ("seconds", -1.0), ("seconds", math.inf)):
        with pytest.raises(InputError, match="expected"):
            QualitySettings(**{name: value})
    for seconds, named in ((1800.0, True), (0.0, False)):
        chosen = QualitySettings(camera="saved", fit="fit", seconds=seconds)
        copied = step(ProjectState(psf="H.h5", settings={"quality": chosen.to_dict()}))
        assert ("--fit=fit" in copied.arguments) is named


def test_the_window_reads_the_control_frames_of_a_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfcal.judge.quality._units.read_checks", lambda _: [])
    save(PSFMatrix(np.ones((1, 3, 3, 15, 15))), tmp_path / "H.h5")
    stamp = stamp_of(str(tmp_path / "H.h5"))
    assert stamp is not None
    asked = asked_of(stamp, QualitySettings(session="session"), None)
    with pytest.raises(InputError, match="session: expected control frames, got none"):
        drain(iter_judge(asked, InspectionRun()))
    assert asked.choices != asked_of(stamp, QualitySettings(), None).choices


def test_a_mat_file_is_inspected_in_its_order(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    monkeypatch.chdir(tmp_path)
    save_v73(tmp_path / "H.mat", H=np.random.default_rng(5).random((15, 15, 3, 3, 2)))
    project = ProjectState(psf="H.mat", settings={"quality": QualitySettings(seconds=0.0).to_dict()})
    project = replace(project, settings=OpeningSettings().with_order("H.mat", "rows-first").into(project))
    stamp = stamp_of("H.mat")
    assert stamp is not None
    chosen, kept = QualitySettings.of(project), InspectionRun()
    asked = asked_of(stamp, chosen, None, "rows-first")
    assert asked.choices != asked_of(stamp, chosen, None).choices
    drain(iter_judge(asked, kept))
    drain(iter_write_report("H.mat", "by_window", kept.inspection, "rows-first"))
    copied = step(project, "by_command").arguments
    assert "--mat-order=rows-first" in copied and lfcal(*copied).code in (0, 1)
    assert alike(measured(Path("by_command")), measured(Path("by_window")))


def test_a_comparison_names_the_order_that_holds_for_both() -> None:
    first, second, h = ("a.mat", 0, 0), ("b.mat", 0, 0), ("H.h5", 0, 0)
    one = CompareRequest(first, h, False, ("rows-first", ""))
    copied = compare_step("a.mat", "H.h5", mat_order=one.mat_order)
    assert copied.arguments == ("compare", "a.mat", "H.h5", "--mat-order=rows-first")
    assert "open_psf('a.mat', mat_order='rows-first') as a, open_psf('H.h5') as b" in copied.python
    with pytest.raises(InputError, match=r"expected the same for both \.mat files"):
        _ = CompareRequest(first, second, False, ("rows-first", "")).mat_order
