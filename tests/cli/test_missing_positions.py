"""H with positions that were never recorded: what is made of it says so, and formats that cannot mark them refuse."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import InputError
from lfcal.psf import Facts, PSFMatrix, export, open_psf, save
from lfcal.psf.facts import Origin
from lfcal.psf.light import empty_positions, empty_words
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]
SHAPE = (2, 3, 3, 5, 5)
SAID = "2 of 18 positions are missing, the first at (z, y, x) = (0, 1, 2)"


def matrix(origin: int = Origin.MEASURED) -> PSFMatrix:
    """Return an H without two positions; ``origin`` is of one of them."""
    values = np.random.default_rng(4).random(SHAPE, np.float32)
    recorded, origins = np.ones(SHAPE[:3], int), np.zeros(SHAPE[:3], int)
    recorded[0, 1, 2] = recorded[1, 0, 0] = 0
    origins[1, 0, 0] = origin
    values[recorded == 0] = 0
    facts = Facts.of(SHAPE[:3], SHAPE[3:], recorded=recorded, origin=origins)
    return PSFMatrix(values, depths=(-5.0, 5.0), facts=facts)


@pytest.fixture
def H(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PSFMatrix:
    monkeypatch.chdir(tmp_path)
    made = matrix()
    save(made, "H.h5")
    return made


def test_what_a_model_filled_is_not_missing() -> None:
    assert empty_positions(matrix()).tolist() == [[0, 1, 2], [1, 0, 0]] and empty_words(matrix()) == SAID
    filled = matrix(Origin.MODEL)
    assert empty_words(filled) == "1 of 18 positions is missing, the first at (z, y, x) = (0, 1, 2)"
    assert empty_words(filled.T) == empty_words(filled), "HT keeps the facts of H"
    assert empty_words(PSFMatrix(np.ones(SHAPE))) == ""


@pytest.mark.parametrize("suffix", [".mat", ".npy", ".tif", ".tiff"])
@pytest.mark.parametrize("turned", [False, True])
def test_a_format_that_cannot_mark_them_needs_leave(tmp_path: Path, suffix: str, turned: bool) -> None:
    made = matrix().T if turned else matrix()
    target = tmp_path / f"H{suffix}"
    with pytest.raises(
        InputError, match=r"expected every position recorded or filled, got an H in which 2 of 18 .*--allow-missing"
    ):
        export(made, target)
    assert not list(tmp_path.iterdir())
    assert export(made, target, allow_missing=True) == target
    export(PSFMatrix(np.ones(SHAPE)), tmp_path / f"whole{suffix}")


def test_a_stack_of_one_position_is_refused_only_where_that_one_is_missing(tmp_path: Path) -> None:
    export(matrix(), tmp_path / "there.tif", position=(2, 2))
    with pytest.raises(InputError, match="2 of 18 positions are missing"):
        export(matrix(), tmp_path / "missing.tif", position=(0, 0))


@pytest.mark.parametrize("name", ["H.mat", "H.npy", "H.tif"])
def test_export_refuses_or_says_so(lfcal: Lfcal, H: PSFMatrix, name: str) -> None:
    refused = lfcal("export", "H.h5", "-o", name)
    assert refused.code == 2 and SAID in refused.err and refused.err.count("\n") == 1 and not Path(name).exists()
    done = lfcal("export", "H.h5", "-o", name, "--allow-missing")
    assert done.code == 0 and done.err.count("missing") == 1
    assert f"{SAID}: they are zeros, which the file cannot mark" in done.err


def test_an_h_file_marks_them(lfcal: Lfcal, H: PSFMatrix) -> None:
    done = lfcal("export", "H.h5", "-o", "again.h5")
    assert done.code == 0 and f"{SAID}: the file marks them" in done.err
    with open_psf("again.h5") as again:
        np.testing.assert_array_equal(again.missing, H.missing)
    useless = lfcal("export", "H.h5", "-o", "other.h5", "--allow-missing")
    assert useless.code == 2 and "--allow-missing: expected a .mat file, a .npy file" in useless.err


@pytest.mark.parametrize("executor", [(), ("--executor", "threads")])
def test_transpose_and_reduce_say_so(lfcal: Lfcal, H: PSFMatrix, executor: tuple[str, ...]) -> None:
    done = lfcal("transpose", "H.h5", "-o", "HT.h5", *executor)
    assert done.code == 0 and done.err.count(SAID) == 1
    back = lfcal("transpose", "HT.h5", "-o", "back.h5", "--json", *executor)
    assert isinstance(back.json, dict) and back.json["missing"] == 2 and SAID in back.err
    small = lfcal("reduce", "H.h5", "-o", "small.h5", *executor)
    assert small.code == 0 and small.err.count(SAID) == 1


def test_reconstruct_says_so_once_for_all_frames(lfcal: Lfcal, H: PSFMatrix) -> None:
    for k in range(2):
        tifffile.imwrite(f"frame{k}.tif", np.random.default_rng(k).random((9, 12), np.float32))
    one = lfcal("reconstruct", "H.h5", "frame0.tif", "-o", "volume.npy", "-n", "1")
    assert one.code == 0 and one.err.count(SAID) == 1
    Path("frames").mkdir()
    for k in range(2):
        Path(f"frame{k}.tif").rename(f"frames/{k}.tif")
    two = lfcal("reconstruct", "H.h5", "frames", "-o", "volumes", "-n", "1", "--executor", "threads")
    assert two.code == 0 and two.err.count(SAID) == 1, two.err
