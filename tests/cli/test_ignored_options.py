"""Options that have no effect on a kind of input are refused by name, not ignored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.camera import ScanPlan, preset
from lfcal.psf import PSFMatrix, open_psf, save, save_regions
from tests.cli.conftest import Lfcal

REFUSED: tuple[tuple[tuple[str, ...], str], ...] = (
    (("simulate", "bench", "--virtual-depths", "4", "-o", "out.h5", "--seed", "1"), "--seed"),
    (("simulate", "bench", "--virtual-depths", "4", "-o", "out.h5", "--peak", "0.5"), "--peak"),
    (("simulate", "bench", "--virtual-depths", "4", "--plan-only", "--peak", "0.5"), "--peak"),
    (("simulate", "bench", "--virtual-depths", "4", "--frames", "out", "--resume"), "--resume"),
    (("simulate", "bench", "--virtual-depths", "4", "--frames", "out", "--store-tolerance", "1%"), "--store-tolerance"),
    (("assemble", "frames", "--lost", "0.01", "-o", "out.h5"), "--lost"),
    (("reconstruct", "H.h5", "frame.tif", "-o", "out.npy", "--format", ".npy"), "--format"),
    (("trend", "--quality", "H.h5", "--sigmas", "3"), "--sigmas"),
    (("multiplex", "coding", "bench", "--plane", "1"), "--plane"),
    (("multiplex", "coding", "H.h5", "--density", "0.3"), "--density"),
    (("multiplex", "coding", "H.h5", "--repeat", "20"), "--repeat"),
    (("multiplex", "coding", "H.h5", "--seed", "2"), "--seed"),
    (("multiplex", "compare", "Bayer", "CYMG", "--gain", "2"), "--gain"),
    (("multiplex", "search", "5", "--chi2", "1", "--gain", "2"), "--gain"),
    (("multiplex", "search", "filters", "--chi2", "1", "--starts", "2"), "--starts"),
    (("multiplex", "design", "2x2", "--chi2", "1", "--gain", "2"), "--gain"),
    (("multiplex", "design", "2x2", "--chi2", "1", "--levels", "3"), "--levels"),
    (("multiplex", "design", "2x2", "--chi2", "1", "--most-light", "0.5"), "--most-light"),
    (("multiplex", "design", "2x2", "--chi2", "1", "--starts", "2"), "--starts"),
    (("multiplex", "design", "3", "--chi2", "1", "--kinds", "2"), "--kinds"),
    (("multiplex", "design", "3", "--chi2", "1", "--letters", "RGB"), "--letters"),
    (("multiplex", "recover", "frame.tif", "--modulator", "Bayer", "-o", "o.tif", "--exposure", "1"), "--exposure"),
    (("multiplex", "recover", "frame.tif", "--modulator", "Bayer", "-o", "o.tif", "--iterations", "5"), "--iterations"),
    (("multiplex", "recover", "frame.tif", "--modulator", "Bayer", "-o", "o.tif", "--smoothness", "1"), "--smoothness"),
    (("multiplex", "demosaic", "frame.tif", "--route", "fourier", "--filter", "cubic", "-o", "out.tif"), "--filter"),
    (("multiplex", "views", "frame.tif", "--camera", "bench", "--gain", "2", "-o", "out.tif"), "--gain"),
    (("accuracy", "list", "--draw", "out.png"), "--draw"),
    (("plan", "bench", "--virtual-depths", "4", "--full", "0.5"), "--full"),
    (("plan", "bench", "--virtual-depths", "4", "--candidates", "5"), "--candidates"),
    (("plan", "bench", "--virtual-depths", "4", "--frames", "frames"), "--frames"),
    (("plan", "bench", "--positions", "list.csv", "--average", "3"), "--average"),
    (("plan", "target", "plan.json", "display:2000x2000@5um", "--pose", "rotation=1"), "--pose"),
    (("plan", "target", "plan.json", "array", "--patterns", "shown"), "--patterns"),
    (("acquire", "plan.json", "-o", "out", "--dry-run", "--steady", "5"), "--steady"),
    (("acquire", "plan.json", "-o", "out", "--dry-run", "--darks", "0", "--dark-every", "9"), "--dark-every"),
    (("acquire", "plan.json", "-o", "out", "--dry-run", "--darks", "0", "--cover"), "--cover"),
    (("assemble", "frames", "--white-mode", "pixels", "-o", "out.h5"), "--white-mode"),
    (("assemble", "frames", "--white-floor", "0.2", "-o", "out.h5"), "--white-floor"),
    (("inspect", "H.h5", "--seconds", "0", "--patterns", "30"), "--patterns"),
    (("camera", "check", "bench", "frame.tif", "--anyway"), "--anyway"),
    (("camera", "import", "plan.json", "--resolution", "40x"), "--resolution"),
    (("views", "frame.tif", "--camera", "bench", "--pitch", "20"), "--pitch"),
    (("views", "frame.tif", "--camera", "bench", "--kind", "square"), "--kind"),
    (("views", "frame.tif", "--camera", "bench", "--depths", "3mm", "--slopes", "1,2"), "--slopes"),
    (("export", "H.h5", "-o", "out.npy", "--rows-first"), "--rows-first"),
    (("export", "H.h5", "-o", "out.h5", "--allow-missing"), "--allow-missing"),
    (("fit", "validate", "fit", "H.h5", "--plan", "plan.json"), "--plan"),
    (("fit", "check", "H.h5", "frame.tif", "--plan", "plan.json"), "--plan"),
    (("fit", "H.h5", "--dark", "none"), "--dark"),
    (("fit", "H.h5", "--black-level", "0"), "--black-level"),
    (("fit", "H.h5", "--white", "frames"), "--white"),
    (("fit", "H.h5", "--orientation", "rot90"), "--orientation"),
    (("fit", "validate", "fit", "H.h5", "--orientation", "rot90"), "--orientation"),
    (("fit", "validate", "fit", "H.h5", "--white", "frames"), "--white"),
    (("fit", "H.h5", "--regions", "3x3"), "--regions"),
)
"""A command on a kind of input, and its option that does not apply."""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make the inputs that the commands name, and go there."""
    monkeypatch.chdir(tmp_path)
    save(PSFMatrix(np.ones((2, 3, 3, 5, 5), np.float32), depths=(1.0, 2.0)), "H.h5")
    tifffile.imwrite("frame.tif", np.ones((12, 12), np.float32))
    Path("frames").mkdir()
    Path("plan.json").write_text(ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,)).to_json())
    return tmp_path


def test_an_option_that_does_not_apply_is_refused(lfcal: Lfcal, place: Path) -> None:
    before = sorted(place.iterdir())
    for words, option in REFUSED:
        done = lfcal(*words)
        assert done.code == 2 and f"{option}: expected" in done.err and done.err.count("\n") == 1, (words, done.err)
        assert sorted(place.iterdir()) == before, words


@pytest.mark.usefixtures("place")
def test_one_of_several_regions_has_to_be_chosen(lfcal: Lfcal) -> None:
    one, other = (PSFMatrix(np.full((1, 3, 3, 3, 3), value, np.float32)) for value in (1.0, 2.0))
    save_regions({"middle": one, "edge": other}, "R.h5")
    for name, *options in (("transpose",), ("transpose", "--method", "paper"), ("reduce",), ("export",)):
        words, out = (name, "R.h5", *options, "-o"), f"{name}{len(options)}.h5"
        lfcal(*words, out).refused("R.h5, region: expected middle or edge, got none; choose one")
        assert not Path(out).exists()
        lfcal(*words, out, "--region", "edge").ok()
        with open_psf(out) as made:
            assert float(made.plane(0).max()) == pytest.approx(2.0, rel=0.01), name


def test_a_reconstruction_with_one_of_several_regions_has_a_note(lfcal: Lfcal, place: Path) -> None:
    H = PSFMatrix(np.ones((1, 2, 2, 3, 3), np.float32))
    save_regions({"middle": H, "edge": H}, "R.h5")
    run = lfcal("reconstruct", "R.h5", "frame.tif", "-o", "v.npy", "-n", "1").ok()
    assert "only middle is used; choose all regions to use all (--region all)" in run.err


def test_a_cutout_is_written_alike_for_every_command(lfcal: Lfcal) -> None:
    """Read, and refused for another reason, as text that is not understood would not be."""
    for name, *more in (("plan",), ("simulate", "--plan-only"), ("accuracy", "--part", "bases")):
        words = (name, "bench", *more, "--virtual-depths", "4", "--cutout")
        for text in ("9x10", "9,10", "9×10"):
            lfcal(*words, text).refused("got 9 x 10")
        lfcal(*words, "9 11").refused("--cutout: expected one number or two (rows,columns)")


def test_a_simulation_that_is_only_planned_writes_nothing(lfcal: Lfcal, place: Path) -> None:
    words = ("simulate", "bench", "--virtual-depths", "4", "--plan-only")
    done = lfcal(*words, "--level", "geometric", "-o", "H2.h5")
    assert done.code == 0 and "engine geometric" in done.out and "H2.h5 is not written" in done.err
    assert not Path("H2.h5").exists()
    lfcal(*words, "--level", "nonsense").refused("nonsense")
