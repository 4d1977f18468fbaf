"""Options that have no effect on a kind of input are refused by name, not ignored."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.psf import PSFMatrix, open_psf, save, save_regions
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]

REFUSED: tuple[tuple[tuple[str, ...], str], ...] = (
    (("simulate", "bench", "--virtual-depths", "4", "-o", "out.h5", "--seed", "1"), "--seed"),
    (("simulate", "bench", "--virtual-depths", "4", "-o", "out.h5", "--peak", "0.5"), "--peak"),
    (("assemble", "frames", "--lost", "0.01", "-o", "out.h5"), "--lost"),
    (("assemble", "frames", "--lost", "0.01", "--cutout", "11", "-o", "out.h5"), "--lost"),
    (("reconstruct", "H.h5", "frame.tif", "-o", "out.npy", "--format", ".npy"), "--format"),
    (("trend", "--quality", "H.h5", "--sigmas", "3"), "--sigmas"),
    (("multiplex", "coding", "bench", "--plane", "1"), "--plane"),
    (("multiplex", "coding", "H.h5", "--density", "0.3"), "--density"),
    (("multiplex", "coding", "H.h5", "--repeat", "20"), "--repeat"),
    (("export", "H.h5", "-o", "out.npy", "--rows-first"), "--rows-first"),
    (("export", "H.h5", "-o", "out.h5", "--allow-missing"), "--allow-missing"),
)
"""A command on a kind of input, and its option that does not apply."""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make the inputs that the commands name, and go there."""
    monkeypatch.chdir(tmp_path)
    save(PSFMatrix(np.ones((2, 3, 3, 5, 5), np.float32), depths=(1.0, 2.0)), "H.h5")
    tifffile.imwrite("frame.tif", np.ones((12, 12), np.float32))
    Path("frames").mkdir()
    return tmp_path


@pytest.mark.parametrize(("words", "option"), REFUSED)
def test_an_option_that_does_not_apply_is_refused(
    lfcal: Lfcal, place: Path, words: tuple[str, ...], option: str
) -> None:
    before = sorted(place.iterdir())
    done = lfcal(*words)
    assert done.code == 2 and f"{option}: expected" in done.err and done.err.count("\n") == 1, done.err
    assert sorted(place.iterdir()) == before


@pytest.mark.parametrize("command", [("transpose",), ("transpose", "--method", "paper"), ("reduce",), ("export",)])
def test_regions_that_are_left_out_are_named(lfcal: Lfcal, place: Path, command: tuple[str, ...]) -> None:
    one, other = (PSFMatrix(np.full((1, 3, 3, 3, 3), value, np.float32)) for value in (1.0, 2.0))
    save_regions({"middle": one, "edge": other}, "R.h5")
    name, *options = command
    done = lfcal(name, "R.h5", "-o", "out.h5", *options)
    assert done.code == 0 and "note: of 2 regions of the field middle alone is written" in done.err
    with open_psf("out.h5") as made:
        assert float(made.plane(0).max()) == pytest.approx(1.0, rel=0.01)


def test_a_reconstruction_with_one_of_several_regions_says_so(lfcal: Lfcal, place: Path) -> None:
    H = PSFMatrix(np.ones((1, 2, 2, 3, 3), np.float32))
    save_regions({"middle": H, "edge": H}, "R.h5")
    done = lfcal("reconstruct", "R.h5", "frame.tif", "-o", "v.npy", "-n", "1")
    assert done.code == 0 and "middle alone is used; --region all uses all" in done.err


@pytest.mark.parametrize("text", ["9x11", "9,11", "9×11"])
def test_a_cutout_is_written_alike_for_plan_and_assemble(text: str) -> None:
    from lfcal.cli import assemble, plan

    assert assemble.parse_cutout(text) == plan.parse_cutout(text) == (9, 11)
