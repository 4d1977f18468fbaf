"""An H that states no depths, as an ``.npy`` does not: its planes have numbers, and no length is made of them."""

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.judge import inspect
from lfcal.judge.comparison import compare
from lfcal.judge.pairing import pair
from lfcal.judge.report import report
from lfcal.psf import PSFMatrix, export, open_psf, save


def values(nz=3):
    rng = np.random.default_rng(5)
    t, s = np.indices((15, 15)) - 7.0
    spot = 100 * np.exp(-0.5 * (t**2 + s**2) / 2.5**2)
    return (spot + rng.random((nz, 3, 3, 15, 15))).astype(np.float32)


@pytest.fixture
def npy(tmp_path):
    np.save(tmp_path / "H.npy", values())
    return tmp_path / "H.npy"


def test_planes_have_numbers_and_no_lengths(npy):
    with open_psf(npy) as H:
        assert not H.knows_depths and np.isnan(H.known_depths).all()
        assert H.depths.tolist() == [0.0, 1.0, 2.0]  # what plots and interpolation count by
        assert not H.T.knows_depths
    known = PSFMatrix(values(), depths=[-3.0, -2.0, -1.0])
    assert known.knows_depths and known.known_depths.tolist() == known.depths.tolist() == [-3.0, -2.0, -1.0]


def test_nothing_that_is_written_states_any(npy, tmp_path):
    with open_psf(npy) as H:
        save(H, tmp_path / "H.h5")
        save(H.T, tmp_path / "HT.h5")
        for name in ("H.mat", "one.tif", "again.h5"):
            export(H, tmp_path / name)
        tiff = next(tmp_path.glob("one*.tif"))
    for name in ("H.h5", "HT.h5", "again.h5", "H.mat"):
        with open_psf(tmp_path / name) as found:
            assert not found.knows_depths, name
            assert not (found.T if found.is_transposed else found).knows_depths
    with h5py.File(tmp_path / "H.h5") as file:
        assert file["depths"].attrs["unit"] == "plane" and file["depths"].attrs["units"] == ""
    with h5py.File(tmp_path / "H.mat") as file:
        assert "H" in file and "x3objspace" not in file
    with tifffile.TiffFile(tiff) as file:
        said = str(file.imagej_metadata or file.ome_metadata)
    assert " um" not in said and "PositionZ" not in said and "spacing" not in said
    save(PSFMatrix(values(), depths=[-3.0, -2.0, -1.0]), tmp_path / "known.h5")
    with h5py.File(tmp_path / "known.h5") as file:  # counter-test
        assert file["depths"].attrs["unit"] == "um"


@pytest.mark.long
def test_reports_name_planes_by_their_numbers(npy, tmp_path):
    with open_psf(npy) as H:
        quality = inspect(H)
        report(H, tmp_path / "report")
    assert quality.extent == "" and quality.plane_words(1) == "plane 1"
    assert quality.to_dict()["planes"][1]["depth_um"] is None
    text = next((tmp_path / "report").rglob("*.html")).read_text(encoding="utf-8")
    assert "plane 1" in text and "depths not stated" in text and "1 µm" not in text
    with_depths = inspect(PSFMatrix(values(), depths=[-3000.0, -2000.0, -1000.0]))
    assert with_depths.extent == "-3 mm to -1 mm" and with_depths.plane_words(1, "z") == "z = -2 mm"


def test_planes_are_compared_by_their_numbers(npy):
    known = PSFMatrix(values(), depths=[-3000.0, -2000.0, -1000.0])
    with open_psf(npy) as H:
        for a, b, which in ((H, known, "the first"), (known, H, "the second")):
            found = pair(a, b)
            assert found.planes == ((0, 0), (1, 1), (2, 2))
            assert [note for note in found.notes if note.startswith(which) and "equal numbers" in note]
        assert pair(H, H).planes == ((0, 0), (1, 1), (2, 2)) and pair(H, H).notes == ("both are the same file",)
        assert compare(H, known).correlation == pytest.approx(1.0)
    assert not pair(known, known).notes


def test_a_camera_needs_the_depths_of_its_planes():
    with pytest.raises(InputError, match="depths"):
        PSFMatrix(values(), camera=preset("bench"))
    with pytest.raises(InputError, match="one for each plane"):
        PSFMatrix(values(), depths=[1.0, np.nan, 2.0])
