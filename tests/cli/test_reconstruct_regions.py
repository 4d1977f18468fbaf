"""``lfcal reconstruct --region``: H of several regions of the field, by file and by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.psf import PSFMatrix, save, save_regions
from lfcal.reconstruct import FieldProjector, Projector, SolverChoice, reconstruct
from lfcal.reconstruct.volumes import load_volume
from tests.cli.conftest import Run
from tests.reconstruct.oracles import lenslet_psf

Lfcal = Callable[..., Run]
SHAPE = (30, 41)
RL = ("--solver", "rl", "-n", 3, "--margin", 0)


def h_at(column: int) -> PSFMatrix:
    spread = 0.7 + 0.01 * column
    H = lenslet_psf(2, 5, 15, spread=spread).astype(np.float32)
    return PSFMatrix(H, anchor=(1.0, float(column)), depths=(-5.0, 5.0), region=f"c{column}")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder: H of three regions, together in one file, too, and two frames."""
    monkeypatch.chdir(tmp_path)
    for column in (2, 17, 32):
        save(h_at(column), tmp_path / f"H{column}.h5")
    save_regions({f"c{column}": h_at(column) for column in (2, 17, 32)}, tmp_path / "all.h5")
    frames = np.random.default_rng(0).poisson(50.0, (2, *SHAPE)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "frames.tif", frames, photometric="minisblack")
    tifffile.imwrite(tmp_path / "frame.tif", frames[0], photometric="minisblack")
    (tmp_path / "words.txt").write_text("no H")
    return tmp_path


def by_the_library(columns: tuple[int, ...], anchor: tuple[float, float] | None = None) -> np.ndarray:
    P = FieldProjector([h_at(column) for column in columns], SHAPE, anchor)
    frame = tifffile.imread("frame.tif").astype(np.float32)
    return np.asarray(reconstruct(P, frame, SolverChoice("rl", 3)).volume)


def test_by_file(lfcal: Lfcal, place: Path) -> None:
    run = lfcal("reconstruct", "H2.h5", "frame.tif", *RL, "--region", "H17.h5", "--region", "H32.h5", "-o", "v.h5")
    assert run.code == 0, run.err
    found = load_volume(place / "v.h5")
    np.testing.assert_allclose(found, by_the_library((2, 17, 32)), rtol=1e-4, atol=1e-3)
    one = lfcal("reconstruct", "H2.h5", "frame.tif", *RL, "-o", "one.npy")
    assert one.code == 0 and np.abs(np.load("one.npy") - found).max() > 0.01 * found.max()
    with h5py.File("v.h5") as file:
        assert json.loads(str(file.attrs["details"]))["regions"] == ["c2", "c17", "c32"]


@pytest.mark.parametrize(
    ("names", "columns"), [(("c32",), (2, 32)), (("c32", "c17"), (2, 32, 17)), (("all",), (2, 17, 32))]
)
def test_by_name(lfcal: Lfcal, place: Path, names: tuple[str, ...], columns: tuple[int, ...]) -> None:
    more = [word for name in names for word in ("--region", name)]
    run = lfcal("reconstruct", "all.h5", "frame.tif", *RL, *more, "-o", "v.npy")
    assert run.code == 0, run.err
    np.testing.assert_allclose(np.load("v.npy"), by_the_library(columns), rtol=1e-4, atol=1e-3)


def test_an_anchor_and_a_margin_move_all_of_them(lfcal: Lfcal, place: Path) -> None:
    words = ("reconstruct", "H2.h5", "frame.tif", *RL, "--region", "H32.h5", "--anchor", "4,5")
    assert lfcal(*words, "-o", "v.npy").code == 0
    np.testing.assert_allclose(np.load("v.npy"), by_the_library((2, 32), (4.0, 5.0)), rtol=1e-4, atol=1e-3)
    assert lfcal(*words, "--margin", 5, "-o", "wide.npy").code == 0
    P = FieldProjector([h_at(2), h_at(32)], (40, 51), (9.0, 10.0))
    frame = tifffile.imread("frame.tif").astype(np.float32)
    wide = reconstruct(P, frame, SolverChoice("rl", 3, margin=5)).volume
    np.testing.assert_allclose(np.load("wide.npy"), wide, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("executor", ["threads", pytest.param("processes", marks=pytest.mark.long)])
def test_in_units(lfcal: Lfcal, place: Path, executor: str) -> None:
    words = (
        "reconstruct",
        "all.h5",
        "frames.tif",
        *RL,
        "--region",
        "c17",
        "--region",
        "H32.h5",
        "--workers",
        1,
    )
    assert lfcal(*words, "-o", "one.npy").code == 0
    run = lfcal(*words, "-o", "two.npy", "--executor", executor)
    assert run.code == 0, run.err
    assert (place / "one.npy").read_bytes() == (place / "two.npy").read_bytes()


def test_the_forecast_is_that_of_all(lfcal: Lfcal, place: Path) -> None:
    words = ("reconstruct", "H2.h5", "frame.tif", "--forecast", "--json", "--method", "direct", "--margin", 0)
    one, two = (lfcal(*words, *more).json for more in ((), ("--region", "H32.h5")))
    assert isinstance(one, dict) and isinstance(two, dict)
    assert two["forecast"]["operand_bytes"] > 2 * one["forecast"]["operand_bytes"] - 1
    alone = Projector(h_at(2), SHAPE, method="direct")
    assert alone.forecast().chosen.operand_bytes == one["forecast"]["operand_bytes"]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--region", "none.h5"), "--region: expected a region of H2.h5 (c2) or an H file, got none.h5"),
        (("--region", "all"), "expected regions other than the first of H2.h5, got none; leave --region out"),
        (("--region", "H2.h5"), "a different position for each, got regions 1 and 2 at the same position"),
        (("--region", "words.txt"), "words.txt"),
        (("--region", "H17.h5", "--resample", "always"), "--resample: expected H of one region"),
    ],
)
def test_what_is_no_other_region_is_refused(lfcal: Lfcal, place: Path, more: tuple[str, ...], words: str) -> None:
    run = lfcal("reconstruct", "H2.h5", "frame.tif", *more, "-o", "v.npy")
    assert run.code == 2 and words in run.err and run.err.count("\n") == 1, run.err
    assert not (place / "v.npy").exists()


def test_h_of_a_region_is_never_replaced(lfcal: Lfcal, place: Path) -> None:
    before = (place / "H17.h5").read_bytes()
    run = lfcal("reconstruct", "H2.h5", "frame.tif", "--region", "H17.h5", "-o", "H17.h5", "--force")
    assert run.code == 2 and "a file other than the input" in run.err
    assert (place / "H17.h5").read_bytes() == before
