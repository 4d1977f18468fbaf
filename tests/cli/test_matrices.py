"""``lfcal export``, ``lfcal transpose`` and ``lfcal reduce``: files of H."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan, preset
from lfcal.psf import Facts, PSFMatrix, export, open_psf, save
from lfcal.psf.facts import Origin
from lfcal.psf.light import empty_positions, empty_words
from lfcal.psf.saving import iter_transpose_file
from lfcal.work import parts_folder
from tests.cli._building import alike
from tests.cli.conftest import Lfcal, small_plan
from tests.judge.plain_report import undrawn
from tests.psf.test_joining import contents
from tests.psf.test_mat_import import as_meant, prevedel, save_v73
from tests.psf.test_reduced_file import matrix as known_matrix

# -- Every option of ``lfcal export`` and ``lfcal transpose`` changes the file, or is refused for that kind of file --
GZIP, ZSTD = 1, 32015
"""Numbers of the filters in HDF5."""


@pytest.fixture
def H(tmp_path: Path) -> PSFMatrix:
    """Save an H of two planes, 3 x 3 positions, 5 x 7 pixels."""
    values = np.random.default_rng(0).random((2, 3, 3, 5, 7), np.float32)
    matrix = PSFMatrix(values, depths=(-5.0, 5.0))
    save(matrix, tmp_path / "H.h5")
    return matrix


def compression_of(path: Path) -> list[int]:
    """Return the filters that compress H, without those that sort bytes or add a checksum."""
    with h5py.File(path) as file:
        plist = file["H"].id.get_create_plist()
        filters = [plist.get_filter(k)[0] for k in range(plist.get_nfilters())]
    return [number for number in filters if number in (GZIP, ZSTD)]


def test_mat_without_ht_rows_first_uncompressed(lfcal: Lfcal, H: PSFMatrix, tmp_path: Path) -> None:
    lfcal("export", tmp_path / "H.h5", "--out", tmp_path / "all.mat").ok()
    options = ("--no-ht", "--rows-first", "--uncompressed")
    lfcal("export", tmp_path / "H.h5", "--out", tmp_path / "H.mat", *options).ok()
    with h5py.File(tmp_path / "all.mat") as both, h5py.File(tmp_path / "H.mat") as one:
        assert "Ht" in both and "Ht" not in one
        # square, for the codes that crop rows and columns alike
        square = np.pad(np.asarray(H), [(0, 0)] * 3 + [(1, 1), (0, 0)])
        np.testing.assert_allclose(both["H"][()], square, rtol=1e-6)
        # H(t, s, y, x, z) of MATLAB, whose axes HDF5 lists the other way round
        np.testing.assert_allclose(one["H"][()], square.transpose(0, 2, 1, 4, 3), rtol=1e-6)
    assert compression_of(tmp_path / "all.mat") and not compression_of(tmp_path / "H.mat")


def test_lens_centred_by_whole_pixels_and_by_what_they_leave(lfcal: Lfcal, tmp_path: Path) -> None:
    camera = preset("lfm_20x05")  # its lenses are centred between pixels
    plan = ScanPlan.for_camera(camera, depths_um=[0.0], cutout=3)
    values = np.random.default_rng(1).random(plan.shape, np.float32)
    save(PSFMatrix(values, camera=camera, anchor=plan.anchor, depths=[0.0]), tmp_path / "H.h5")
    export = ("export", tmp_path / "H.h5", "--no-ht", "--force", "--out", tmp_path / "H.mat")
    told = lfcal(*export)
    assert told.code == 0 and "a lens is centred on row 8.50 and column 8.50" in told.err
    assert "row 8 and column 8" in told.err
    assert "the centre of the lens is (+0.50, +0.50) px" in lfcal(*export, "--lens-centred").ok().err
    with h5py.File(tmp_path / "H.mat") as file:
        np.testing.assert_allclose(file["lensCentre"][()], [[8.5], [8.5]])
        np.testing.assert_allclose(file["H"][()], values)
    moved = lfcal(*export, "--lens-centred", "--interpolation", "linear", "--json")
    assert moved.code == 0 and moved.json["notes"] == []
    with h5py.File(tmp_path / "H.mat") as file:
        np.testing.assert_allclose(file["lensCentre"][()], [[8], [8]])
        mean = (values[..., :-1, :] + values[..., 1:, :]) / 2
        np.testing.assert_allclose(file["H"][()][..., :2, :2], (mean[..., :-1] + mean[..., 1:]) / 2, rtol=1e-5)
    lfcal(*export, "--interpolation", "linear").refused("--interpolation: expected --lens-centred, got none")
    lfcal(*export, "--lens-centred", "--interpolation", "sinc").refused(
        "interpolation: expected nearest, linear, cubic or fourier"
    )


def test_a_file_of_another_code_becomes_an_h_file_with_a_note(lfcal: Lfcal, tmp_path: Path) -> None:
    prevedel(tmp_path / "theirs.mat", np.random.default_rng(2).random((5, 5, 3, 3, 2)), np.array([[1, 5], [2, 4]]))
    done = lfcal("export", tmp_path / "theirs.mat", "--out", tmp_path / "H.h5")
    assert done.code == 0 and "CAindex" in done.err and "rows first" in done.err
    lfcal("verify", tmp_path / "H.h5").ok()
    again = lfcal("export", tmp_path / "H.h5", "--out", tmp_path / "H.mat", "--lens-centred", "--json")
    assert again.code == 0, "its lenses are where its code puts them"
    assert all("lens" not in note for note in again.json["notes"])
    with open_psf(tmp_path / "H.h5") as ours, open_psf(tmp_path / "H.mat") as back:
        np.testing.assert_allclose(np.asarray(back), np.asarray(ours))


def test_the_transpose_one_position_and_an_uncompressed_file(lfcal: Lfcal, H: PSFMatrix, tmp_path: Path) -> None:
    for name, more in (
        ("HT.npy", ("--transposed",)),
        ("HT.h5", ("--transposed",)),
        ("p.tif", ("--position", "2,1")),
        ("u.h5", ("--uncompressed",)),
    ):
        lfcal("export", tmp_path / "H.h5", "--out", tmp_path / name, *more).ok()
    np.testing.assert_array_equal(np.load(tmp_path / "HT.npy"), np.asarray(H.T))
    with open_psf(tmp_path / "HT.h5") as matrix:
        assert matrix.is_transposed
        np.testing.assert_array_equal(np.asarray(matrix), np.asarray(H.T))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "p.tif"), np.asarray(H)[:, 2, 1])
    assert compression_of(tmp_path / "H.h5") and not compression_of(tmp_path / "u.h5")


REFUSED = (
    ("H.mat --lens-centred", "expected an H with its camera"),
    ("x.npy --no-ht", "expected a .mat file or a file for one code (--for), got a .npy file"),
    ("x.h5 --lens-centred --interpolation cubic", "expected a .mat file, got a .h5 file"),
    ("x.tif --resume", "expected work that is done in units, got a .tif file"),
    ("x.tif --position 1", "--position: expected y,x, got '1'"),
    ("x --no-ht", "got no suffix"),
    ("x.tif --for olaf", "expected a .mat file for oLaF, got x.tif"),
    ("x.mat --for other", "expected olaf, prevedel, pyolaf"),
    ("x.npz --for pyolaf --sparse", "--sparse: expected --for olaf"),
    ("x.npz --for pyolaf --rows-first", "expected a .mat file, got a file for one code"),
    ("x.tif --for flfm", "H for FLFM: expected one pattern for each plane, got 3 x 3 positions"),
)
"""Other options that a format would ignore: tests/tasks/test_matrices.py."""


@pytest.mark.usefixtures("H")
def test_what_a_format_would_ignore_is_refused(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for words, said in REFUSED:
        lfcal("export", "H.h5", "--out", *words.split()).refused(said)
        assert [path.name for path in tmp_path.iterdir()] == ["H.h5"], words


def test_transpose_to_a_file_by_any_compression_and_threads(lfcal: Lfcal, H: PSFMatrix, tmp_path: Path) -> None:
    for compression, numbers in (("zstd", [ZSTD]), ("none", [])):
        out = tmp_path / f"{compression}.h5"
        lfcal("transpose", tmp_path / "H.h5", "--out", out, "--compression", compression, "--workers", 1).ok()
        assert compression_of(out) == numbers
        with open_psf(out) as matrix:
            np.testing.assert_array_equal(np.asarray(matrix), np.asarray(H.T))
    assert lfcal("transpose", tmp_path / "H.h5", "--out", tmp_path / "n.h5", "--workers", 0).code == 2
    assert not (tmp_path / "n.h5").exists()


# -- ``lfcal reduce``: H within a tolerance, file to file, in units and after a stop --
@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder, the current one, with an H of which much is known."""
    monkeypatch.chdir(tmp_path)
    save(known_matrix(), tmp_path / "H.h5")
    return tmp_path


def test_within_the_tolerance_and_smaller(lfcal: Lfcal, place: Path) -> None:
    for tolerance, more in ((0.05, ()), (0.005, ("--compression", "none", "--workers", 1))):
        words = ("reduce", "H.h5", "--out", "small.h5", "--force", "--tolerance", tolerance)
        run = lfcal(*words).ok()
        assert "small.h5: H (2, 5, 5, 15, 15), " in run.out and "no pattern loses more than" in run.out
        assert (place / "small.h5").stat().st_size < (place / "H.h5").stat().st_size
        with open_psf(place / "H.h5") as H, open_psf(place / "small.h5") as small:
            lacking = np.abs(small[:].astype(float) - H[:]).sum(axis=(3, 4))
            assert (lacking <= tolerance * np.abs(H[:].astype(float)).sum(axis=(3, 4))).all() and lacking.any()
        found = lfcal(*words, *more, "--json").ok().json
        bound = np.array(found["bound"])
        assert found["tolerance"] == tolerance and bound.shape == (2, 3) and 0 < bound[:, 2].max() <= tolerance
        assert found["bytes"] == (place / "small.h5").stat().st_size
    assert found["bytes"] > 2 * 2 * 25 * 225, "not compressed"


def test_a_refused_plane_keeps_those_that_are_done(lfcal: Lfcal, place: Path) -> None:
    bad = known_matrix()[:].copy()
    bad[0] = 0  # which any steps can store
    save(PSFMatrix(bad), place / "bad.h5")
    words = ("reduce", "bad.h5", "-o", "out.h5", "--tolerance", 1e-6, "--executor", "threads", "--workers", 1)
    said = "storage tolerance: expected a tolerance that at most 65535 steps"
    lfcal(*words).refused(said, "kept: 1 of 2 units in out.h5.parts; --resume continues with them")
    assert not (place / "out.h5").exists()


def test_what_cannot_be_reduced_is_refused(lfcal: Lfcal, place: Path) -> None:
    for tolerance in ("0", "1", "-0.1", "nan"):
        lfcal("reduce", "H.h5", "-o", "out.h5", "--tolerance", tolerance).refused("--tolerance: expected a number")
    with open_psf(place / "H.h5") as H:
        drain(iter_transpose_file(H, place / "HT.h5"))
    for more in ((), ("--executor", "threads")):
        lfcal("reduce", "HT.h5", "-o", "out.h5", *more).refused("got HT; store H, and derive HT from it")
    assert not (place / "out.h5").exists() and not parts_folder(place / "out.h5").exists()


def test_simulated_into_a_small_file(lfcal: Lfcal, place: Path) -> None:
    """As simulated in full and reduced afterwards, and what storage lacks does not count as an error of simulation."""
    (place / "plan.json").write_text(small_plan().to_json())
    words = ("simulate", "plan.json", "--level", "geometric", "-o")
    lfcal(*words, "full.h5").ok()
    lfcal("reduce", "full.h5", "-o", "reduced.h5", "--tolerance", 0.01).ok()
    for out, more in (("small.h5", ()), ("units.h5", ("--executor", "threads", "--workers", 1))):
        run = lfcal(*words, out, "--store-tolerance", 0.01, *more).ok()
        assert "error including that of storage: " in run.err and "(4 % allowed)" in run.err
        one, two = (contents(place / name) for name in ("reduced.h5", out))
        for found in (one, two):  # but for the tasks that made them
            known = json.loads(found["@provenance"])
            found["@provenance"] = {key: known[key] for key in known.keys() - {"task", "earlier_tasks"}}
        assert one == two
    for other in (("--progressive", "-o", "o.h5"), ("--frames", "frames")):
        said = "--store-tolerance: expected H in one pass, got"
        lfcal("simulate", "plan.json", *other, "--store-tolerance", 0.01).refused(said)
    lfcal(*words, "o.h5", "--store-tolerance", 2).refused()


# -- Every command that reads a ``.mat`` H says the order of its axes, and takes another one by ``--mat-order`` --
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


UNITS = ("--executor", "threads")


@pytest.mark.parametrize(
    ("command", "more"),
    [
        ("export", ()),
        ("transpose", UNITS),
        pytest.param("transpose", (), marks=pytest.mark.long),
        pytest.param("reduce", ("--tolerance", "0.001"), marks=pytest.mark.long),
        pytest.param("reduce", ("--tolerance", "0.001", *UNITS), marks=pytest.mark.long),
    ],
)
def test_files_are_made_of_a_mat_file(
    lfcal: Lfcal, theirs: np.ndarray, tmp_path: Path, command: str, more: tuple[str, ...]
) -> None:
    wanted = np.asarray(PSFMatrix(theirs).T) if command == "transpose" else theirs
    words = (command, tmp_path / "H.mat", "-o", tmp_path / "out.h5", "--force", *more)
    assert "rows first, as requested" in lfcal(*words, *ROWS).ok().err
    np.testing.assert_allclose(values(tmp_path / "out.h5"), wanted, rtol=0.05, atol=1e-3)
    assert "--mat-order rows-first" in lfcal(*words).ok().err
    assert np.abs(values(tmp_path / "out.h5") - wanted).max() > 0.1, "the option is what makes it right"


def test_h_that_is_compared_or_inspected(
    lfcal: Lfcal, theirs: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mat, right = tmp_path / "H.mat", tmp_path / "right.h5"
    same = lfcal("compare", mat, right, *ROWS, "--json")
    assert same.code == 0 and same.json["worst"][0]["error"] < 1e-3, same.out
    other = lfcal("compare", mat, right, "--json")
    assert other.json["worst"][0]["error"] > 0.1 and "--mat-order rows-first" in other.err
    judged = lfcal("inspect", right, "--reference", mat, "--seconds", "0", *ROWS, "--json")
    assert judged.json["comparison"]["rms_error"] < 1e-3
    undrawn(monkeypatch)
    report = ("--report", tmp_path / "report", "--executor", "threads")
    by_units = lfcal("inspect", mat, "--reference", right, "--seconds", "0", *report, *ROWS, "--json")
    alone = lfcal("inspect", mat, "--seconds", "0", *ROWS, "--json")
    own = {"comparison": 0, "report": 0}
    assert alike({**by_units.json, **own}, {**alone.json, **own}), "the units read it rows first"
    guessed = lfcal("inspect", mat, "--seconds", "0", "--json")
    assert not alike(guessed.json, alone.json), "it makes a difference"


def test_a_volume_is_reconstructed_with_a_mat_file(lfcal: Lfcal, theirs: np.ndarray, tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "frame.tif", np.random.default_rng(6).random((12, 15), np.float32) * 100)
    for executor in ((), ("--executor", "threads")):
        found = {}
        for name, H, order in (("right", "right.h5", ()), ("stated", "H.mat", ROWS), ("guessed", "H.mat", ())):
            words = (tmp_path / H, tmp_path / "frame.tif", "-o", tmp_path / "v.npy", "--force", "-n", "2")
            lfcal("reconstruct", *words, *order, *executor).ok()
            found[name] = np.load(tmp_path / "v.npy")
        np.testing.assert_allclose(found["stated"], found["right"], rtol=1e-3)
        assert np.abs(found["guessed"] - found["right"]).max() > 0.1 * found["right"].max()


def test_figures_that_are_worked_out_of_it(lfcal: Lfcal, theirs: np.ndarray, tmp_path: Path) -> None:
    coding = ("multiplex", "coding", "--sensor", "bench", "--points", "3", "--json")
    told = [lfcal(*coding, tmp_path / "right.h5"), lfcal(*coding, tmp_path / "H.mat", *ROWS)]
    gains = [one.json["equal_time"] for one in told if isinstance(one.json, dict)]
    assert len(gains) == 2 and gains[0] == pytest.approx(gains[1], rel=1e-4) and "as requested" in told[1].err
    run = lfcal("accuracy", tmp_path / "H.mat", "--part", "storage", "--seconds", "0.1", *ROWS, "--json").ok()
    assert "as requested" in run.err


def test_the_order_of_axes_is_refused_where_no_file_is_mat(lfcal: Lfcal, theirs: np.ndarray, tmp_path: Path) -> None:
    right, out, frame = tmp_path / "right.h5", tmp_path / "out.h5", tmp_path / "frame.tif"
    tifffile.imwrite(frame, np.ones((12, 15), np.float32))
    for words in (
        *((command, right, "-o", out) for command in ("export", "transpose", "reduce")),
        ("compare", right, right),
        ("inspect", right),
        ("reconstruct", right, frame, "-o", tmp_path / "v.npy"),
        ("accuracy", right),
        ("multiplex", "coding", right),
    ):
        lfcal(*words, *ROWS).refused("--mat-order", "expected a .mat file, got right.h5")
        lfcal(*words, "--mat-order", "stxyz").refused("expected rows-first or columns-first, got", "stxyz")
    assert not out.exists()


# -- H with positions that were never recorded: what is made of it says so, and formats that cannot mark them refuse --
SHAPE = (2, 3, 3, 5, 5)
SAID = "2 of 18 positions are missing, the first at (z, y, x) = (0, 1, 2)"


def lacking(origin: int = Origin.MEASURED) -> PSFMatrix:
    """Return an H without two positions; ``origin`` is of one of them."""
    values = np.random.default_rng(4).random(SHAPE, np.float32)
    recorded, origins = np.ones(SHAPE[:3], int), np.zeros(SHAPE[:3], int)
    recorded[0, 1, 2] = recorded[1, 0, 0] = 0
    origins[1, 0, 0] = origin
    values[recorded == 0] = 0
    facts = Facts.of(SHAPE[:3], SHAPE[3:], recorded=recorded, origin=origins)
    return PSFMatrix(values, depths=(-5.0, 5.0), facts=facts)


@pytest.fixture
def incomplete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PSFMatrix:
    monkeypatch.chdir(tmp_path)
    made = lacking()
    save(made, "H.h5")
    return made


def test_what_a_model_filled_is_not_missing() -> None:
    assert empty_positions(lacking()).tolist() == [[0, 1, 2], [1, 0, 0]] and empty_words(lacking()) == SAID
    filled = lacking(Origin.MODEL)
    assert empty_words(filled) == "1 of 18 positions is missing, the first at (z, y, x) = (0, 1, 2)"
    assert empty_words(filled.T) == empty_words(filled), "HT keeps the facts of H"
    assert empty_words(PSFMatrix(np.ones(SHAPE))) == ""


def test_a_format_that_cannot_mark_them_needs_leave(tmp_path: Path) -> None:
    said = r"expected every position recorded or filled, got an H in which 2 of 18 .*--allow-missing"
    for suffix in (".mat", ".npy", ".tif", ".tiff"):
        for k, made in enumerate((lacking(), lacking().T)):
            target = tmp_path / f"H{k}{suffix}"
            with pytest.raises(InputError, match=said):
                export(made, target)
            assert not target.exists() and export(made, target, allow_missing=True) == target
        export(PSFMatrix(np.ones(SHAPE)), tmp_path / f"whole{suffix}")
    export(lacking(), tmp_path / "there.tif", position=(2, 2))
    with pytest.raises(InputError, match="2 of 18 positions are missing"):
        export(lacking(), tmp_path / "missing.tif", position=(0, 0))


def test_export_refuses_missing_positions_or_names_them(lfcal: Lfcal, incomplete: PSFMatrix) -> None:
    for name in ("H.mat", "H.npy", "H.tif"):
        lfcal("export", "H.h5", "-o", name).refused(SAID)
        assert not Path(name).exists()
        done = lfcal("export", "H.h5", "-o", name, "--allow-missing").ok()
        assert done.err.count("missing") == 1 and f"{SAID}: they are zeros, which the file cannot mark" in done.err
    assert f"{SAID}: the file marks them" in lfcal("export", "H.h5", "-o", "again.h5").ok().err
    with open_psf("again.h5") as again:
        np.testing.assert_array_equal(again.missing, incomplete.missing)


def test_transpose_reduce_and_reconstruct_name_missing_positions_once(lfcal: Lfcal, incomplete: PSFMatrix) -> None:
    for executor in ((), ("--executor", "threads")):
        more = ("--force", *executor)
        assert lfcal("transpose", "H.h5", "-o", "HT.h5", *more).ok().err.count(SAID) == 1
        back = lfcal("transpose", "HT.h5", "-o", "back.h5", "--json", *more).ok()
        assert back.json["missing"] == 2 and SAID in back.err
        assert lfcal("reduce", "H.h5", "-o", "small.h5", *more).ok().err.count(SAID) == 1
    Path("frames").mkdir()
    for k in range(2):
        tifffile.imwrite(f"frames/{k}.tif", np.random.default_rng(k).random((9, 12), np.float32))
    for words in (("frames/0.tif", "-o", "v.npy"), ("frames", "-o", "volumes", "--executor", "threads")):
        assert lfcal("reconstruct", "H.h5", *words, "-n", "1").ok().err.count(SAID) == 1
