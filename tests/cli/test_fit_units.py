"""``lfcal fit``: H of the fitted camera in units of a plane, the same by every executor and after a stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import StorageError
from lfcal.base.progress import drain
from lfcal.fit import Fit
from lfcal.fit.files import iter_write_model
from lfcal.psf import save
from lfcal.work import RunChoice, parts_folder
from tests.cli.conftest import Run
from tests.fit.commands import undrawn
from tests.fit.common import few_fit, few_patterns
from tests.psf.test_joining import contents

Lfcal = Callable[..., Run]


def two_planes() -> Fit:
    """Return a fit of two planes: that of the few patterns, and the same a little farther away."""
    fit = few_fit()
    planned = replace(fit.planned, depths_um=(fit.planned.depths_um[0], 1.02 * fit.planned.depths_um[0]))
    setup = replace(fit.setup, depth_errors_um=(*fit.setup.depth_errors_um, 3.0))
    gains = np.array([fit.levels.gains[0], 0.9 * fit.levels.gains[0]])
    return replace(fit, planned=planned, setup=setup, levels=replace(fit.levels, gains=gains))


@pytest.mark.long
@pytest.mark.parametrize("executor", ["processes", "threads", "dask"])
def test_the_same_file_by_whoever(tmp_path: Path, executor: str) -> None:
    if executor == "dask":
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
    fit = two_planes()
    drain(iter_write_model(fit, tmp_path / "one.h5", workers=1))
    drain(iter_write_model(fit, tmp_path / "two.h5", workers=1, run=RunChoice(executor, 1)))
    assert contents(tmp_path / "one.h5") == contents(tmp_path / "two.h5")
    assert not parts_folder(tmp_path / "two.h5").exists()


def test_a_stop_keeps_the_planes(tmp_path: Path) -> None:
    fit, out = two_planes(), tmp_path / "H.h5"
    work = iter_write_model(fit, out, run=RunChoice("threads", 1))
    for record in work:
        if record.note.startswith("1 of"):
            break
    work.close()
    kept = next(parts_folder(out).glob("*.h5"))
    stamp = kept.stat().st_mtime_ns
    again = iter_write_model(fit, out, run=RunChoice("threads", 1, begun="resume"))
    next(again)
    assert kept.stat().st_mtime_ns == stamp
    drain(again)
    drain(iter_write_model(fit, tmp_path / "one.h5", workers=1))
    assert contents(out) == contents(tmp_path / "one.h5")


def test_the_command(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit is made again after a stop, and gives the same camera to the last bit."""
    save(few_patterns(), tmp_path / "few.h5")
    monkeypatch.chdir(tmp_path)
    undrawn(monkeypatch)
    words = ("fit", "few.h5", "--unknowns", "geometry", "--workers", 1, "-o")
    assert lfcal(*words, "one").code == 0
    run = lfcal(*words, "two", "--executor", "threads")
    assert run.code == 0, run.err
    assert contents(tmp_path / "one" / "H.h5") == contents(tmp_path / "two" / "H.h5")
    assert not parts_folder(tmp_path / "two" / "H.h5").exists()


def test_a_fit_that_ended_after_h_goes_on(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its report was not there yet; it asked for --force, as if H were somebody else's."""
    save(few_patterns(), tmp_path / "few.h5")
    monkeypatch.chdir(tmp_path)
    undrawn(monkeypatch)
    words = ("fit", "few.h5", "--unknowns", "geometry", "--workers", 1, "-o", "fit")
    with monkeypatch.context() as full:

        def fails(*_: object) -> object:
            raise StorageError("no space left")
            yield

        full.setattr("lfcal.fit.files.iter_fit_report", fails)
        assert "no space left" in lfcal(*words, "--executor", "threads").err
    assert (tmp_path / "fit" / "H.h5").exists() and parts_folder(tmp_path / "fit" / "H.h5").exists()
    assert lfcal(*words).code == 2
    run = lfcal(*words, "--resume")
    assert run.code == 0, run.err
    assert (tmp_path / "fit" / "fit.json").exists() and not parts_folder(tmp_path / "fit" / "H.h5").exists()


def test_what_has_no_units_is_refused(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(few_patterns(), tmp_path / "few.h5")
    monkeypatch.chdir(tmp_path)
    for words, said in (
        (("--hybrid", "--executor", "processes"), "got --hybrid; leave --executor or --hybrid out"),
        (("--no-h", "--resume"), "got --no-h; leave --resume or --no-h out"),
        (("--executor", "threads", "--scheduler", "tcp://a:1"), "an executor with a scheduler (dask)"),
    ):
        run = lfcal("fit", "few.h5", *words)
        assert run.code == 2 and said in run.err, run.err
    run = lfcal("fit", "check", "few.h5", "few.tif", "--scheduler", "tcp://a:1")
    assert run.code == 2 and "No such option: --scheduler" in run.err
    assert {path.name for path in tmp_path.iterdir()} == {"few.h5"}
