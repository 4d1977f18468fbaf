"""Every command that reads a ``.mat`` H says the order of its axes, and takes another one by ``--mat-order``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.psf import open_psf, save
from lfcal.psf.matrix import PSFMatrix
from tests.cli.conftest import Run
from tests.cli.test_inspect_units import alike
from tests.judge.plain_report import undrawn
from tests.psf.test_mat_import import as_meant, save_v73

Lfcal = Callable[..., Run]


@pytest.fixture
def theirs(tmp_path: Path) -> np.ndarray:
    """Write ``H(t, s, y, x, z)`` in a file that states nothing of its axes; return it in lfcal's order."""
    H = np.random.default_rng(5).random((5, 5, 3, 3, 2))
    H *= np.linspace(0.1, 1, 5)[:, None, None, None, None]
    H[:, :, 0, 2] *= 3  # one position brighter than its neighbours: it is listed by its place
    save_v73(tmp_path / "H.mat", H=H, x3objspace=[-1e-6, 1e-6])
    meant = as_meant(H).astype(np.float32)
    save(PSFMatrix(meant, depths=(-1.0, 1.0)), tmp_path / "right.h5")
    return meant


def values(path: Path) -> np.ndarray:
    with open_psf(path) as matrix:
        return np.asarray(matrix)


ROWS = ("--mat-order", "rows-first")


@pytest.mark.parametrize("executor", [(), ("--executor", "threads")])
def test_files_that_are_made_of_it(lfcal: Lfcal, theirs: np.ndarray, tmp_path: Path, executor: tuple[str, ...]) -> None:
    mat = tmp_path / "H.mat"
    turned = np.asarray(PSFMatrix(theirs).T)
    for command, wanted, more in (
        ("export", theirs, ()),
        ("transpose", turned, executor),
        ("reduce", theirs, ("--tolerance", "0.001", *executor)),
    ):
        out = tmp_path / f"{command}.h5"
        done = lfcal(command, mat, "-o", out, *ROWS, *more)
        assert done.code == 0 and "rows first, as requested" in done.err, done.err
        np.testing.assert_allclose(values(out), wanted, rtol=0.05, atol=1e-3)
        guessed = lfcal(command, mat, "-o", out, "--force", *more)
        assert guessed.code == 0 and "--mat-order rows-first" in guessed.err
        assert np.abs(values(out) - wanted).max() > 0.1, "the option is what makes it right"


def test_h_that_is_compared_or_inspected(
    lfcal: Lfcal, theirs: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mat, right = tmp_path / "H.mat", tmp_path / "right.h5"
    same = lfcal("compare", mat, right, *ROWS, "--json")
    assert same.code == 0 and isinstance(same.json, dict) and same.json["worst"][0]["error"] < 1e-3, same.out
    other = lfcal("compare", mat, right, "--json")
    assert (
        isinstance(other.json, dict) and other.json["worst"][0]["error"] > 0.1 and "--mat-order rows-first" in other.err
    )
    judged = lfcal("inspect", right, "--reference", mat, "--seconds", "0", *ROWS, "--json")
    assert isinstance(judged.json, dict) and judged.json["comparison"]["rms_error"] < 1e-3
    undrawn(monkeypatch)
    report = ("--report", tmp_path / "report", "--executor", "threads")
    by_units = lfcal("inspect", mat, "--reference", right, "--seconds", "0", *report, *ROWS, "--json")
    alone = lfcal("inspect", mat, "--seconds", "0", *ROWS, "--json")
    assert isinstance(by_units.json, dict) and isinstance(alone.json, dict)
    own = {"comparison": 0, "report": 0}
    assert alike({**by_units.json, **own}, {**alone.json, **own}), "the units read it rows first"
    guessed = lfcal("inspect", mat, "--seconds", "0", "--json")
    assert isinstance(guessed.json, dict) and not alike(guessed.json, alone.json), "it makes a difference"


@pytest.mark.parametrize("executor", [(), ("--executor", "threads")])
def test_a_volume(lfcal: Lfcal, theirs: np.ndarray, tmp_path: Path, executor: tuple[str, ...]) -> None:
    tifffile.imwrite(tmp_path / "frame.tif", np.random.default_rng(6).random((12, 15), np.float32) * 100)
    found = {}
    for name, H, order in (("right", "right.h5", ()), ("stated", "H.mat", ROWS), ("guessed", "H.mat", ())):
        out = tmp_path / f"{name}.npy"
        done = lfcal("reconstruct", tmp_path / H, tmp_path / "frame.tif", "-o", out, "-n", "2", *order, *executor)
        assert done.code == 0, done.err
        found[name] = np.load(out)
    np.testing.assert_allclose(found["stated"], found["right"], rtol=1e-3)
    assert np.abs(found["guessed"] - found["right"]).max() > 0.1 * found["right"].max()


def test_figures_that_are_worked_out_of_it(lfcal: Lfcal, theirs: np.ndarray, tmp_path: Path) -> None:
    coding = ("multiplex", "coding", "--sensor", "bench", "--points", "3", "--json")
    told = [lfcal(*coding, tmp_path / "right.h5"), lfcal(*coding, tmp_path / "H.mat", *ROWS)]
    gains = [one.json["equal_time"] for one in told if isinstance(one.json, dict)]
    assert len(gains) == 2 and gains[0] == pytest.approx(gains[1], rel=1e-4) and "as requested" in told[1].err
    done = lfcal("accuracy", tmp_path / "H.mat", "--part", "storage", "--seconds", "0.1", *ROWS, "--json")
    assert done.code == 0 and "as requested" in done.err


def test_it_is_refused_where_no_file_is_mat(lfcal: Lfcal, theirs: np.ndarray, tmp_path: Path) -> None:
    right, out = tmp_path / "right.h5", tmp_path / "out.h5"
    frame = tmp_path / "frame.tif"
    for words in (
        ("export", right, "-o", out),
        ("transpose", right, "-o", out),
        ("reduce", right, "-o", out),
        ("compare", right, right),
        ("inspect", right),
        ("reconstruct", right, frame, "-o", tmp_path / "v.npy"),
        ("accuracy", right),
        ("multiplex", "coding", right),
    ):
        if "reconstruct" in words:
            tifffile.imwrite(frame, np.ones((12, 15), np.float32))
        done = lfcal(*words, *ROWS)
        assert done.code == 2 and "expected a .mat file, got right.h5" in done.err and "--mat-order" in done.err, (
            words,
            done.err,
        )
        wrong = lfcal(*words, "--mat-order", "stxyz")
        assert wrong.code == 2 and "expected rows-first or columns-first, got" in wrong.err and "stxyz" in wrong.err
    assert not out.exists()
