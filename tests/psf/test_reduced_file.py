"""An H file within a tolerance: patterns in whole steps, their bound, and all that reads an H."""

from __future__ import annotations

import itertools
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.h5.chunks import encode_chunk
from lfcal.camera import preset
from lfcal.judge import compare, inspect
from lfcal.psf import Facts, PSFMatrix, export, open_psf, opening, save, save_regions, verify
from lfcal.psf._steps import SteppedPlane, bits_at_most, bound_after, stepped_plane
from lfcal.psf._transpose import transpose
from lfcal.psf.facts import pack_valid
from lfcal.reconstruct import Projector
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


def test_its_transpose_and_its_way_to_another_process(path: Path, tmp_path: Path) -> None:
    with open_psf(path) as small:
        turned = transpose(small[:])
        np.testing.assert_array_equal(small.T[:], turned)
        np.testing.assert_array_equal(small.T[1, 2, 3], turned[1, 2, 3])
        assert small.T.T is small
        save(small.T, tmp_path / "HT.h5")
        with open_psf(tmp_path / "HT.h5") as HT:
            np.testing.assert_array_equal(HT.T[:], small[:])
            np.testing.assert_array_equal(HT.T.facts.known()["bound"], small.facts.known()["bound"])
        sent = pickle.dumps(small.T)
        assert len(sent) < 10_000
        with pickle.loads(sent) as back:
            np.testing.assert_array_equal(back[0, 3, 4], turned[0, 3, 4])


@pytest.mark.parametrize(
    "method",
    ["polyphase", *(pytest.param(method, marks=pytest.mark.long) for method in ("direct", "sparse", "reduced"))],
)
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


def test_inspection_and_comparison(tmp_path: Path) -> None:
    H = PSFMatrix(np.random.default_rng(0).random((2, 5, 5, 31, 31), np.float32))
    with open_psf(save(H, tmp_path / "small.h5", store_tolerance=TOLERANCE)) as small:
        ours, theirs = ({m.spec.key: m.value for m in inspect(one).metrics} for one in (small, H))
        assert ours.keys() == theirs.keys()
        found = compare(small, H)
        assert 1 - 1e-4 < found.correlation < 1 and 0 < np.nanmax(found.error) < 2 * TOLERANCE
        np.testing.assert_allclose(found.all.scale, 1, atol=TOLERANCE)
        assert found.max_shift_px < 0.05


def test_exports_hold_the_same_values(path: Path, tmp_path: Path) -> None:
    with open_psf(path) as small:
        export(small, tmp_path / "out.tif", allow_missing=True)
        assert (tmp_path / "out.tif").stat().st_size > 4 * small.size
        for suffix in (".h5", ".mat", ".npy"):
            out = tmp_path / f"out{suffix}"
            export(small, out, **({} if suffix == ".h5" else {"allow_missing": True}))
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


def test_what_cannot_be_reduced_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    bad = matrix()[:].copy()
    bad[1, 0, 0, 0, 0] = np.nan
    ht = r"storage tolerance: expected H.*got HT; store H, and derive HT from it"
    for H, tolerance, words in (
        (PSFMatrix(bad), TOLERANCE, r"plane 1.*expected finite values"),
        (matrix(), 1e-8, r"plane 0.*65535 steps"),
        (matrix().T, TOLERANCE, ht),
    ):
        with pytest.raises(InputError, match=words):
            save(H, tmp_path / "H.h5", store_tolerance=tolerance)
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


def test_steps_that_are_none_are_refused(old: Path) -> None:
    whole = old.read_bytes()
    alone = "expected steps of uint16 patterns, step and zero, got uint16 alone"
    changes: list[tuple[Callable[[Any], None], str]] = [
        *((lambda file, name=name: file.__delitem__(name), alone) for name in ("step", "zero")),
        *((put("step", value), "expected steps above 0 that give finite values") for value in (0.0, -1.0, 1e36)),
        (put("step", np.nan), "/step"),
    ]
    for change, words in changes:
        old.write_bytes(whole)
        with h5py.File(old, "r+") as file:
            change(file)
        with pytest.raises(FileFormatError) as refused:
            open_psf(old)
        assert words in str(refused.value) and "\n" not in str(refused.value)
    old.write_bytes(whole)
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


# -- patterns in whole steps -------------------------------------------------------------------------------------------


Plane = NDArray[np.float64]


def spots(seed: int = 0, cutout: int = 15) -> Plane:
    """Return a plane ``(5, 5, cutout, cutout)`` of spots with weak light between them."""
    plane: Plane = lenslet_psf(1, 5, cutout)[0]
    return plane + 1e-3 * np.random.default_rng(seed).random(plane.shape)


def signed(seed: int = 0) -> Plane:
    """Return spots with noise about zero."""
    return spots(seed) - 2e-3 + 1e-3 * np.random.default_rng(seed + 1).normal(size=(5, 5, 15, 15))


def shares(plane: Plane, found: SteppedPlane) -> Plane:
    """Return the part of each pattern that is missing, computed separately."""
    lacking = np.abs(plane - found.values.astype(float)).sum(axis=(2, 3))
    own = np.abs(plane).sum(axis=(2, 3))
    return np.divide(lacking, own, out=np.zeros_like(own), where=own > 0)


@pytest.mark.parametrize("tolerance", [0.1, 0.005, 0.0005])
@pytest.mark.parametrize("make", [spots, signed])
def test_the_bound_holds_against_the_dense_matrix(make: Callable[[int], Plane], tolerance: float) -> None:
    """|(H - Hs) g|_1 for random g and for single voxels, whose worst is near it: it is not vacuous."""
    plane = make(3)
    found = stepped_plane(plane, tolerance)
    bound, size = found.bound[2], (23, 21)
    assert 0 < bound <= tolerance
    H, Hs = (dense(values[None].astype(float), size) for values in (plane, found.values))
    light = np.abs(plane).sum(axis=(2, 3))[np.indices(size)[0] % 5, np.indices(size)[1] % 5].ravel()
    rng = np.random.default_rng(1)
    for g in (rng.random(light.size), rng.random(light.size) ** 20, rng.integers(0, 2, light.size)):
        assert np.abs((H - Hs) @ g).sum() <= bound * (g @ light)
    each = np.abs(H - Hs).sum(axis=0) / light
    assert each.max() <= bound * (1 + 1e-9) and each.max() > 0.9 * bound
    assert each.max() > 0.5 * tolerance, "all of the tolerance is used"


@pytest.mark.parametrize("make", [spots, signed])
def test_shares_are_those_of_the_values_read_back(make: Callable[[int], Plane]) -> None:
    plane = make(0)
    found = stepped_plane(plane, 0.004)
    np.testing.assert_allclose(found.cut + found.rounding, shares(plane, found), rtol=1e-9)
    whole = np.abs(plane - found.values.astype(float)).sum() / np.abs(plane).sum()
    assert found.error == pytest.approx(whole) and found.error <= found.bound[2] <= 0.004
    threaded = stepped_plane(plane, 0.004, workers=4)
    for name in ("values", "step", "cut", "rounding"):
        np.testing.assert_array_equal(getattr(found, name), getattr(threaded, name))


def test_rows_and_columns_without_light_are_cut_and_their_light_is_counted() -> None:
    plane = spots()
    wide = np.zeros((5, 5, 41, 35))
    wide[:, :, 10:25, 12:27] = plane
    wide += 1e-9 * np.random.default_rng(0).random(wide.shape)
    found = stepped_plane(wide, 0.005)
    assert found.bound[0] > 0
    np.testing.assert_allclose(found.cut + found.rounding, shares(wide, found), rtol=1e-9)
    lit = (found.values != 0).any(axis=(0, 1))
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    assert (rows[0], rows[-1], columns[0], columns[-1]) == (10, 24, 12, 26)


def test_dead_dim_and_single_pixel_patterns() -> None:
    plane = spots()
    plane[0, 0] = 0
    plane[1, 1] *= 1e-7
    plane[2, 2] = 0
    plane[2, 2, 3, 4] = 5.0
    plane[3, 3] = -plane[3, 3]
    plane[4, 4] = 0.25
    found = stepped_plane(plane, 0.005)
    values = found.values
    assert not values[0, 0].any() and (values[3, 3] <= 0).all()
    assert np.count_nonzero(values[2, 2]) == 1 and values[2, 2, 3, 4] == pytest.approx(5.0, rel=0.005)
    assert shares(plane, found).max() <= 0.005
    assert not stepped_plane(np.zeros((2, 2, 3, 3)), 0.005).values.any()


def test_planes_of_any_scale_and_type() -> None:
    """A 16-bit float would end at 65504 and lose what is below 6e-8."""
    for scale in (1e-30, 1e-12, 1.0, 1e11, 1e30):
        for dtype in (np.float32, np.float64):
            plane = (signed() * scale).astype(dtype)
            assert 0.0025 < shares(plane.astype(float), stepped_plane(plane, 0.005)).max() <= 0.005
    plane = np.random.default_rng(0).integers(0, 60000, (3, 4, 5, 7)).astype(np.uint16)
    assert 0 < shares(plane.astype(float), stepped_plane(plane, 0.002)).max() <= 0.002


def test_whole_numbers_that_the_finest_step_keeps_exactly() -> None:
    """An error of 0 does not show how errors grow with the step."""
    plane = np.zeros((1, 1, 3, 3))
    plane[0, 0, :, 0] = 65534, 1000, 7  # a step of 1 is the finest of all
    for tolerance in (1e-6, 1e-5, 1e-3):
        assert shares(plane, stepped_plane(plane, tolerance)).max() <= tolerance


def test_planes_and_tolerances_that_cannot_be_stored_are_refused() -> None:
    for value in (np.nan, np.inf, -np.inf):
        plane = spots()
        plane[2, 3, 1, 1] = value
        words = r"plane 7, position \(2, 3\): expected finite values, got NaN or infinity"
        with pytest.raises(InputError, match=words):
            stepped_plane(plane, 0.005, what="plane 7")
    for tolerance in (0.0, -0.1, 1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="a fraction above 0 and below 1"):
            stepped_plane(spots(), tolerance)
    with pytest.raises(InputError, match=r"position \(0, 0\).*65535 steps.*1e-06 %; choose a larger tolerance"):
        stepped_plane(spots(), 1e-8)
    with pytest.raises(InputError, match="65535 steps per pattern"):
        stepped_plane(spots() * 1e-200, 0.005)  # nothing that float32 holds


def test_errors_add_up() -> None:
    plane = signed()
    first = stepped_plane(plane, 0.01)
    second = stepped_plane(first.values, 0.02)
    both = bound_after(first.bound, second.bound)
    lacking = np.abs(plane - second.values).sum(axis=(2, 3)) / np.abs(plane).sum(axis=(2, 3))
    assert lacking.max() <= both[2] <= 0.01 + 0.02 * 1.01 and lacking.max() > both[2] / 3
    np.testing.assert_array_equal(bound_after(np.full(3, np.nan), second.bound), second.bound)
    np.testing.assert_array_equal(bound_after(None, second.bound), second.bound)


def test_the_room_that_patterns_take_is_predicted() -> None:
    """The room asked for suffices, even where H is nothing but noise."""
    for kind, tolerance in itertools.product(("laplace", "normal", "uniform", "exponential"), (0.05, 0.005, 0.001)):
        plane = getattr(np.random.default_rng(0), kind)(size=(2, 2, 61, 61))
        found = stepped_plane(plane, tolerance)
        nbytes = sum(len(encode_chunk(pattern, 1)) for row in found.values for pattern in row)
        assert 8 * nbytes / plane.size < bits_at_most(tolerance) < 2.5 * 8 * nbytes / plane.size, (kind, tolerance)
