"""An H file within a tolerance: all that reads an H reads it, what is known of it stays, and damage is told."""

from __future__ import annotations

import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError
from lfcal.camera import preset
from lfcal.fit import fit_camera
from lfcal.judge import compare, inspect
from lfcal.psf import Facts, PSFMatrix, export, open_psf, opening, save, save_regions, verify
from lfcal.psf._transpose import transpose
from lfcal.psf.facts import pack_valid
from lfcal.reconstruct import Projector, richardson_lucy
from tests.fit.common import few_fit, few_patterns
from tests.reconstruct.oracles import dense, lenslet_psf

TOLERANCE = 0.005


def matrix() -> PSFMatrix:
    """Return a signed H of two planes, of whose positions much is known."""
    rng = np.random.default_rng(0)
    values = lenslet_psf(2, 5, 15) - 1e-3 + 1e-3 * rng.normal(size=(2, 5, 5, 15, 15))
    values[0, 1, 2] = 0
    recorded = np.ones((2, 5, 5), np.uint16)
    recorded[0, 1, 2] = 0
    facts = Facts.of(
        (2, 5, 5),
        (15, 15),
        recorded=recorded,
        noise=np.full((2, 5, 5, 2), 1e-4),
        valid=pack_valid(rng.random(values.shape) < 0.9),
        error=[0.01, np.nan],
    )
    made = {"camera": preset("bench"), "anchor": (1.0, 2.0), "depths": (-5.0, 5.0), "provenance": {"made": "here"}}
    return PSFMatrix(values.astype(np.float32), facts=facts, uncertainty=0.1 * np.abs(values), **made)  # type: ignore[arg-type]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return save(matrix(), tmp_path / "small.h5", store_tolerance=TOLERANCE)


def within(found: Any, truth: Any, tolerance: float = TOLERANCE) -> None:
    """Hold each pattern ``(…, t, s)`` against its own light."""
    lacking = np.abs(np.asarray(found, float) - truth).sum(axis=(-2, -1))
    assert (lacking <= tolerance * np.abs(np.asarray(truth, float)).sum(axis=(-2, -1))).all() and lacking.any()


def test_values_and_all_that_is_known(path: Path) -> None:
    H = matrix()
    with open_psf(path, check=True) as small:
        assert small.shape == H.shape and small.dtype == np.float32 and repr(small).startswith("<PSFMatrix (z, y, x")
        within(small[:], H[:])
        np.testing.assert_array_equal(small[1, 2, 3], small.plane(1)[2, 3])
        np.testing.assert_array_equal(small[1, :2, 3, 4:, 5], small[:][1, :2, 3, 4:, 5])
        np.testing.assert_allclose(small.depth_sum(1), small.plane(1).sum(axis=(0, 1)), rtol=1e-5, atol=1e-6)
        assert (small.anchor, small.camera) == (H.anchor, H.camera) and small.provenance["made"] == "here"
        np.testing.assert_array_equal(small.depths, H.depths)
        for name in ("recorded", "noise", "valid"):
            np.testing.assert_array_equal(getattr(small.facts, name), getattr(H.facts, name))
        stated, truth = small.stated_uncertainty, H.stated_uncertainty
        assert stated is not None and truth is not None
        ratio = stated.plane(0)[truth.plane(0) > 0] / truth.plane(0)[truth.plane(0) > 0]
        assert ratio.min() >= 1 and ratio.max() <= 1 + 1 / 128, "rounded up"
        bound, error = small.facts.known()["bound"], small.facts.known()["error"]
        assert (bound[:, 2] <= TOLERANCE).all() and (bound[:, 2] > TOLERANCE / 2).all()
        assert 0.01 < error[0] <= 0.01 + TOLERANCE and 0 < error[1] <= TOLERANCE


def test_it_travels_as_its_path(path: Path) -> None:
    with open_psf(path) as small:
        sent = pickle.dumps(small.T)
        assert len(sent) < 10_000
        with pickle.loads(sent) as back:
            np.testing.assert_array_equal(back[0, 3, 4], small.T[0, 3, 4])


def test_its_transpose(path: Path, tmp_path: Path) -> None:
    with open_psf(path) as small:
        turned = transpose(small[:])
        np.testing.assert_array_equal(small.T[:], turned)
        np.testing.assert_array_equal(small.T[1, 2, 3], turned[1, 2, 3])
        assert small.T.T is small
        save(small.T, tmp_path / "HT.h5")
        with open_psf(tmp_path / "HT.h5") as HT:
            np.testing.assert_array_equal(HT.T[:], small[:])
            np.testing.assert_array_equal(HT.T.facts.known()["bound"], small.facts.known()["bound"])


@pytest.mark.few(2)
@pytest.mark.parametrize("method", ["polyphase", "direct", "sparse", "reduced"])
def test_every_projector(path: Path, method: str) -> None:
    more = {"tolerance": 0.01} if method == "reduced" else {}
    rng, size = np.random.default_rng(1), (23, 21)
    g = rng.random((2, *size)).astype(np.float32)
    with open_psf(path) as small:
        P = Projector(small, size, (0, 0), method, workers=1, **more)  # type: ignore[arg-type]
        truth = matrix()[:].astype(float)
        light = np.abs(truth).sum(axis=(3, 4))[:, np.indices(size)[0] % 5, np.indices(size)[1] % 5]
        lacking = np.abs(P.forward(g) - (dense(truth, size) @ g.ravel().astype(float)).reshape(size)).sum()
        bound = small.facts.known()["bound"][:, 2].max()
        bound += 0.01 * (1 + bound) if more else 0
        assert 0 < lacking <= bound * float((light * g).sum()) * (1 + 1e-4)


def test_reconstruction(path: Path) -> None:
    rng, size = np.random.default_rng(2), (25, 25)
    with open_psf(path) as small:
        image = np.maximum(Projector(small, size, workers=1).forward(rng.random((2, *size))), 0)
        found = richardson_lucy(Projector(small, size, workers=1), image, iterations=2)
    truth = richardson_lucy(Projector(matrix(), size, workers=1), image, iterations=2)
    volumes = [np.asarray(getattr(one, "volume", one)) for one in (found, truth)]
    assert np.abs(volumes[0] - volumes[1]).sum() < 0.05 * np.abs(volumes[1]).sum()


def test_inspection_and_comparison(tmp_path: Path) -> None:
    H = PSFMatrix(np.random.default_rng(0).random((2, 5, 5, 31, 31), np.float32))
    with open_psf(save(H, tmp_path / "small.h5", store_tolerance=TOLERANCE)) as small:
        ours, theirs = ({m.spec.key: m.value for m in inspect(one).metrics} for one in (small, H))
        assert ours.keys() == theirs.keys()
        found = compare(small, H)
        assert 1 - 1e-4 < found.correlation < 1 and 0 < np.nanmax(found.error) < 2 * TOLERANCE
        np.testing.assert_allclose(found.all.scale, 1, atol=TOLERANCE)
        assert found.max_shift_px < 0.05


@pytest.mark.long
def test_fit(tmp_path: Path) -> None:
    """A recorded H within a tolerance below its noise is fitted as it is."""
    with open_psf(save(few_patterns(), tmp_path / "fit.h5", store_tolerance=0.002)) as small:
        fits = fit_camera(small, unknowns=["geometry"], workers=1), few_fit()
    gaps = [fit.parameters["gap_um"] for fit in fits]
    assert abs(gaps[0].value - gaps[1].value) < 0.5 * gaps[1].sigma


@pytest.mark.parametrize("suffix", [".h5", ".mat", ".npy", ".tif"])
def test_exports_hold_the_same_values(path: Path, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"out{suffix}"
    with open_psf(path) as small:
        export(small, out, **({} if suffix == ".h5" else {"allow_missing": True}))
        if suffix == ".tif":
            assert out.stat().st_size > 4 * small.size
            return
        with open_psf(out) as back:
            np.testing.assert_array_equal(np.asarray(back[:], np.float32), small[:])
            if suffix == ".h5":
                np.testing.assert_array_equal(back.facts.known()["bound"], small.facts.known()["bound"])


def test_reduced_again_errors_add_up(path: Path, tmp_path: Path) -> None:
    with open_psf(path) as small, open_psf(save(small, tmp_path / "b.h5", store_tolerance=0.02)) as smaller:
        within(smaller[:], small[:], 0.02)
        first, both = (one.facts.known()["bound"][:, 2] for one in (small, smaller))
        assert (both > first).all() and (both <= TOLERANCE + 0.02 * (1 + TOLERANCE)).all()
        lacking = np.abs(smaller[:].astype(float) - matrix()[:]).sum(axis=(3, 4))
        assert (lacking <= both[:, None, None] * np.abs(matrix()[:]).sum(axis=(3, 4))).all()
        assert (smaller.facts.known()["error"] > small.facts.known()["error"]).all()


def test_a_scale_of_the_plane_has_no_bound(path: Path, tmp_path: Path) -> None:
    """Rounding to steps of the whole plane says nothing of single patterns: what was certified is so no more."""
    with open_psf(path) as small:
        other = PSFMatrix(np.float32(1.1) * small[:], facts=small.facts)
        with open_psf(save(other, tmp_path / "b.h5", dtype="rounded")) as rounded:
            assert rounded.facts.bound is None
        with open_psf(save(small, tmp_path / "c.h5", dtype="rounded")) as exact:
            np.testing.assert_array_equal(exact.facts.known()["bound"], small.facts.known()["bound"])


def test_ht_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"storage tolerance: expected H.*got HT; store H, and derive HT from it"):
        save(matrix().T, tmp_path / "HT.h5", store_tolerance=TOLERANCE)
    assert not list(tmp_path.iterdir())


def test_nothing_half_written_stays(tmp_path: Path) -> None:
    bad = matrix()[:].copy()
    bad[1, 0, 0, 0, 0] = np.nan
    with pytest.raises(InputError, match=r"plane 1.*expected finite values"):
        save(PSFMatrix(bad), tmp_path / "H.h5", store_tolerance=TOLERANCE)
    with pytest.raises(InputError, match=r"plane 0.*65535 steps"):
        save(matrix(), tmp_path / "H.h5", store_tolerance=1e-8)
    assert not list(tmp_path.iterdir())


def test_it_is_as_specified_and_whole(path: Path) -> None:
    check = verify(path)
    assert check.ok and check.compared and check.planes == 2 and check.missing == 1
    with h5py.File(path) as file:
        assert file.attrs["version"] == 4
        step = file["step"][...]
        whole = file["H"][...] / step[..., None, None]
    np.testing.assert_array_equal(whole, np.rint(whole))
    mantissa = np.frexp(step)[0] * 4
    np.testing.assert_array_equal(mantissa, np.rint(mantissa))


def test_earlier_programs_refuse_it(path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(opening, "VERSIONS", (1, 2, 3))
    with pytest.raises(FileFormatError, match="expected format version 3 or older, got version 4; update lfcal"):
        open_psf(path)


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """Return a file of version 3, whose integers are numbers of steps."""
    return shutil.copy(Path(__file__).parents[1] / "corpus" / "v0_1" / "version_3_steps.h5", tmp_path / "old.h5")


def put(name: str, value: Any) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        file[name][1, 2, 1] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda file: file.__delitem__("step"), "expected steps of uint16 patterns, step and zero, got uint16 alone"),
        (lambda file: file.__delitem__("zero"), "expected steps of uint16 patterns, step and zero, got uint16 alone"),
        (put("step", 0.0), "expected steps above 0 that give finite values"),
        (put("step", -1.0), "expected steps above 0 that give finite values"),
        (put("step", 1e36), "expected steps above 0 that give finite values"),
        (put("step", np.nan), "/step"),
    ],
)
def test_steps_that_are_none_are_refused(old: Path, change: Callable[[Any], None], said: str) -> None:
    with h5py.File(old, "r+") as file:
        change(file)
    with pytest.raises(FileFormatError) as refused:
        open_psf(old)
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_another_step_is_seen_by_its_sums(old: Path) -> None:
    with h5py.File(old, "r+") as file:
        file["step"][1, 1, 1] *= 2
    assert [(d.z, d.what) for d in verify(old).damaged] == [(1, "depth sum changed")]


def test_regions_may_be_within_a_tolerance_each_in_a_file(path: Path, tmp_path: Path) -> None:
    """Several regions are written in full, whatever their source."""
    with open_psf(path) as small:
        save_regions({"middle": small, "edge": matrix()}, tmp_path / "R.h5")
        with open_psf(tmp_path / "R.h5") as back:
            np.testing.assert_array_equal(back[:], small[:])
            np.testing.assert_array_equal(back.facts.known()["bound"], small.facts.known()["bound"])
