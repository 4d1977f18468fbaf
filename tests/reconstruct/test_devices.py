"""Projection through the array API standard: on the processor by numpy, array-api-strict and PyTorch where it is."""

from __future__ import annotations

import importlib.util
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import InputError
from lfcal.reconstruct import Projector, SolverChoice, reconstruct
from lfcal.reconstruct.memory import run_memory
from lfcal.reconstruct.projectors import device as devices
from lfcal.reconstruct.projectors._device_direct import DeviceDirect
from lfcal.reconstruct.projectors._device_engine import Placement
from lfcal.reconstruct.projectors._device_forecast import ON_DEVICES, DeviceRates, device_rates, forecast_on
from lfcal.reconstruct.projectors._device_polyphase import DevicePolyphase
from lfcal.reconstruct.projectors._device_sparse import DeviceSparse
from lfcal.reconstruct.projectors._tiles import TilePlan
from lfcal.reconstruct.projectors.device import LIBRARIES as ON_ACCELERATORS
from lfcal.reconstruct.projectors.device import ArrayDevice, check_arithmetic, device_count, driver_present, find_device
from tests.reconstruct.oracles import dense, lenslet_psf
from tests.reconstruct.test_projector import CASES, problem
from tests.reconstruct.test_reduced import slow_psf

NUMPY = ArrayDevice("numpy")
DOUBLE = np.dtype(np.float64)
TORCH = pytest.mark.skipif(
    importlib.util.find_spec("torch") is None or importlib.util.find_spec("array_api_compat") is None,
    reason="PyTorch is not installed",
)
STRICT = pytest.mark.skipif(
    importlib.util.find_spec("array_api_strict") is None, reason="array-api-strict is not installed"
)
LIBRARIES = [
    "numpy",
    pytest.param("array_api_strict", marks=STRICT),
    pytest.param("torch", marks=TORCH),
]
if driver_present():  # a library of this size is not loaded for nothing
    LIBRARIES += [f"{library}:0" for library in ON_ACCELERATORS if device_count(library)]


def place(library):
    """Return the processor's memory with a library, or the accelerator whose number follows its name."""
    name, _, number = library.partition(":")
    return ArrayDevice(name, int(number) if number else None)


def pair(H, image, method, library, **options):
    """Return the projector of the processor and that of a device, otherwise equal."""
    options = {"tolerance": 0.05 if method == "reduced" else 0.0, "dtype": np.float64} | options
    return [Projector(H, image, method=method, device=device, **options) for device in (None, place(library))]


@pytest.mark.few(12)
@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("method", [m for m in ON_DEVICES if m != "reduced"])
@pytest.mark.parametrize("name", CASES)
def test_pair_is_the_dense_matrix_and_its_transpose(name, method, library):
    H, shape, anchor, g, f = problem(name, np.random.default_rng(1))  # signed
    matrix = dense(H, shape, anchor)
    P = Projector(H, shape, anchor, method, dtype=np.float64, device=place(library))
    assert (P.method, P.device) == (method, place(library))
    assert np.allclose(P.forward(g).ravel(), matrix @ g.ravel(), rtol=0, atol=1e-12)
    assert np.allclose(P.adjoint(f).ravel(), matrix.T @ f.ravel(), rtol=0, atol=1e-12)


@pytest.mark.few(4)
@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("image", [(21, 14), pytest.param((40, 33), marks=pytest.mark.long)])
def test_reduced_projections_are_those_of_the_processor(image, signed, library):
    H, rng = slow_psf(signed=signed), np.random.default_rng(0)
    here, there = pair(H, image, "reduced", library, tolerance=0.05, anchor=(-4, 3))
    # nodes that are as far apart as they can be: sums of nodes and other entries both count
    here._engine.work = there._engine.host.work = lambda g, kept: 1 / g
    g, f = rng.random((1, *image)), rng.random(image)
    assert here._operand(0).spacing > 2 and there._operand(0).facts[1] is not None
    ahead, back = here.forward(g), here.adjoint(f)
    assert np.abs(there.forward(g) - ahead).max() <= 1e-13 * np.abs(ahead).max()
    assert np.abs(there.adjoint(f) - back).max() <= 1e-13 * np.abs(back).max()


@settings(max_examples=15, derandomize=True, deadline=None)
@given(
    image=st.tuples(st.integers(1, 18), st.integers(1, 18)),
    period=st.tuples(st.integers(1, 6), st.integers(1, 6)),
    half=st.tuples(st.integers(0, 5), st.integers(0, 5)),
    anchor=st.tuples(st.integers(-9, 9), st.integers(-9, 9)),
    method=st.sampled_from(ON_DEVICES),
)
def test_forward_and_adjoint_have_equal_inner_products(image, period, half, anchor, method):
    rng = np.random.default_rng(image[0] + 31 * image[1])
    H = np.concatenate([slow_psf(period, (2 * half[0] + 1, 2 * half[1] + 1), noise=0.01, signed=k > 0) for k in (0, 1)])
    within = 0.05 if method == "reduced" else 0.0
    P = Projector(H, image, anchor, method, dtype=np.float64, device=NUMPY, tolerance=within)
    g, f = rng.standard_normal(P.volume_shape), rng.standard_normal(image)
    Hg, Hf = P.forward(g), P.adjoint(f)
    size = np.linalg.norm(Hg) * np.linalg.norm(f) + np.linalg.norm(g) * np.linalg.norm(Hf)
    assert abs(np.vdot(Hg, f) - np.vdot(g, Hf)) <= 1e-12 * max(size, 1e-300)


@pytest.mark.few(4)
@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("method", ON_DEVICES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_phases_in_use_and_single_precision(dtype, method, library):
    H, image, rng = lenslet_psf(2, 7, 21), (40, 33), np.random.default_rng(3)
    mask = rng.random((7, 7)) < 0.3
    mask[2] = False  # a row of phases that no window needs
    here, there = pair(H, image, method, library, dtype=dtype, tolerance=0.02 * (method == "reduced"))
    g, f = rng.random(here.volume_shape), rng.random(image)
    off = 30 * np.finfo(dtype).eps
    for P, Q in ((here, there), (here.subset(mask), there.subset(mask))):
        ahead, back = P.forward(g), P.adjoint(f)
        found = Q.forward(g), Q.adjoint(f)
        assert [one.dtype for one in found] == [np.dtype(dtype)] * 2 and found[0].flags.writeable
        assert np.abs(found[0] - ahead).max() <= off * np.abs(ahead).max()
        assert np.abs(found[1] - back).max() <= off * np.abs(back).max()
    assert not there.subset(mask).forward(g)[~there.grid.tiled(mask)].any()


@pytest.mark.few(4)
@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("method", ON_DEVICES)
def test_no_light_in_h_or_in_the_volume(method, library):
    H = lenslet_psf(2, 5, 15)
    H[1] = 0
    _, P = pair(H, (16, 17), method, library)
    g = np.zeros(P.volume_shape)
    assert not P.forward(g).any()
    g[1] = 1
    assert not P.forward(g).any()
    assert not P.adjoint(np.ones((16, 17)))[1].any()


def test_small_steps_change_nothing():
    rng, H = np.random.default_rng(2), lenslet_psf(2, 5, 17)
    P = Projector(H, (48, 57), (1, 1), "direct", dtype=np.float64)
    g, f = rng.standard_normal(P.volume_shape), rng.standard_normal(P.image_shape)
    ahead, back = P.forward(g), P.adjoint(f)
    for room in (1, 1 << 30):
        place = Placement(NUMPY, kept=False, room=room)
        engines = [DeviceDirect(P.grid, DOUBLE, place), DeviceSparse(P.grid, DOUBLE, place)]
        engines += [DevicePolyphase(TilePlan(P.grid, counts), DOUBLE, place) for counts in ((1, 1), (3, 2), (5, 4))]
        for engine in engines:
            operands = [engine.prepare(plane) for plane in H]
            assert not operands[0].there and engine.operand_bytes(operands[0]) > 0
            assert np.allclose(engine.forward(zip(operands, g, strict=True)), ahead, rtol=0, atol=1e-12)
            found = [plane.copy() for plane in engine.adjoint(f, operands)]
            assert np.allclose(np.stack(found), back, rtol=0, atol=1e-12)


def test_a_solver_ends_at_the_same_volume():
    H, rng = lenslet_psf(2, 5, 15), np.random.default_rng(0)
    here, there = pair(H, (40, 40), "auto", "numpy", dtype=np.float32)
    frame = rng.poisson(50 * here.forward(rng.random(here.volume_shape))).astype(np.float32)
    found = [reconstruct(P, frame, SolverChoice("sieve", 4)).volume for P in (here, there)]
    assert np.abs(found[0] - found[1]).max() <= 2e-4 * found[0].max()


# -- memory ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("method", ON_DEVICES)
@pytest.mark.few(1)
def test_planes_are_kept_on_the_device_or_transferred_or_prepared_again(method, monkeypatch):
    with_rates(monkeypatch, 1e10, 1e10, 1e9)
    H = np.tile(lenslet_psf(2, 7, 31).astype(np.float32), (12, 1, 1, 1, 1))
    g, choice = np.random.default_rng(0).random((24, 60, 60)), SolverChoice("rl")

    def on(room, limit=1 << 30):
        options = {"tolerance": 0.02 if method == "reduced" else 0.0, "memory_limit": limit}
        return Projector(H, (60, 60), method=method, device=replace(NUMPY, room=room), **options)

    kept = on(1 << 30).prepare()
    use = kept.forecast().device
    assert use.kept and use.memory_bytes <= use.free and kept._operand(0).there
    assert use.operand_bytes / 1.5 <= kept.operand_bytes() <= 1.5 * use.operand_bytes
    assert run_memory(kept, choice).matrix == 0  # of the processor's memory
    moved = kept
    while moved.forecast().device.kept:  # fewer tiles may fit where more did not
        moved = on(moved.forecast().device.operand_bytes)
    use, cost = moved.forecast().device, moved.forecast().chosen
    assert not moved.prepare()._operand(0).there and cost.resident
    assert use.memory_bytes <= use.free and "transferred for each projection" in str(moved.forecast())
    assert run_memory(moved, choice).matrix == cost.operand_bytes > 0
    again = moved
    while again.forecast().chosen.resident:
        again = on(use.free, again.forecast().chosen.memory_bytes - 1)
    assert not again.prepare().operand_bytes()
    truth = kept.forward(g)
    for P in (moved, again):
        assert np.abs(P.forward(g) - truth).max() <= 1e-5 * truth.max()
    with pytest.raises(InputError, match=r"memory of cpu \(numpy\).*at least .* for one plane.*--device cpu"):
        on(1000)
    with pytest.raises(InputError, match="memory limit for the projection"):
        on(1 << 30, 1000)


def test_a_slower_plan_is_chosen_if_the_quickest_does_not_fit(monkeypatch):
    """It was refused, with what the quickest would take."""
    with_rates(monkeypatch, 1.5e8, 1.4e9, 1.9e9)
    H = np.tile(lenslet_psf(2, 7, 31).astype(np.float32), (12, 1, 1, 1, 1))
    device, costs = replace(NUMPY, room=1 << 30), []
    quickest = Projector(H, (60, 60), method="polyphase", device=device).forecast()
    device = replace(NUMPY, room=quickest.device.operand_bytes)
    for limit in (1 << 30, 1_000_000):
        costs.append(Projector(H, (60, 60), method="polyphase", device=device, memory_limit=limit).forecast().chosen)
    assert costs[1].memory_bytes <= 1_000_000 < costs[0].memory_bytes and costs[1].pair_s > costs[0].pair_s


def with_rates(monkeypatch, *rates):
    """Fix the rates, from which plans follow: those of this machine would make another plan each time."""
    found = DeviceRates(*rates)
    monkeypatch.setattr("lfcal.reconstruct.projectors._device_forecast.device_rates", lambda *_: found)


def test_planes_beyond_the_forecast_stay_with_the_processor():
    H = lenslet_psf(3, 5, 15)
    P = Projector(H, (30, 30), method="sparse", dtype=np.float64)
    device = replace(NUMPY, room=1 << 20)
    engine = DeviceSparse(P.grid, DOUBLE, Placement(device, kept=True, room=(1 << 20) - 1))
    operands = [engine.prepare(plane) for plane in H]
    assert not any(operand.there for operand in operands)
    g = np.random.default_rng(0).random(P.volume_shape)
    assert np.allclose(engine.forward(zip(operands, g, strict=True)), P.forward(g), rtol=0, atol=1e-12)


def test_the_forecast_chooses_the_quickest_method_that_fits():
    H = lenslet_psf(3, 9, 31)
    P = Projector(H, (80, 80), tolerance=0.01, device=NUMPY)
    found = P.forecast()
    assert {o.method for o in found.options} >= {"polyphase", "direct", "reduced"}
    assert found.chosen.pair_s + found.chosen.prepare_s > 0
    assert found.device.memory_bytes <= found.device.free
    assert device_rates(NUMPY, "float32").products > 1e6
    assert "device" in str(found) and "device" not in str(Projector(H, (80, 80)).forecast())


# -- which device ------------------------------------------------------------------------------------------
def test_a_device_is_pickled_by_its_name():
    H = lenslet_psf(1, 5, 15).astype(np.float32)
    P = Projector(H, (20, 20), method="direct", device=NUMPY)
    again = pickle.loads(pickle.dumps(P))
    assert again.device == NUMPY and again.method == "direct"
    assert len(pickle.dumps(ArrayDevice("torch", 1))) < 300


def test_other_words_are_refused():
    for text in ("gpu", "cuda:x", "auto:1", "cpu:0", "", "cuda:"):
        with pytest.raises(InputError, match="device: expected auto, cpu, cuda or cuda:NUMBER"):
            find_device(text)


def with_devices(monkeypatch, **counts):
    monkeypatch.setattr(devices, "device_count", lambda library: counts.get(library, 0))
    monkeypatch.setattr(devices, "driver_present", lambda: True)


def test_without_an_accelerator_auto_uses_the_processor(monkeypatch):
    with_devices(monkeypatch)
    assert find_device("auto") is None and find_device("cpu") is None
    with pytest.raises(InputError, match=r"device cuda: expected an accelerator and PyTorch or CuPy.*choose cpu"):
        find_device("cuda")
    with pytest.raises(InputError, match="device cuda:1"):
        Projector(lenslet_psf(1, 5, 15), (20, 20), device="cuda:1")


def test_each_worker_has_a_device_and_a_number_names_one(monkeypatch):
    with_devices(monkeypatch, cupy=2)
    monkeypatch.setattr(devices, "check_arithmetic", lambda device: None)
    assert [find_device("cuda", worker=k) for k in range(3)] == [ArrayDevice("cupy", k % 2) for k in range(3)]
    assert find_device("cuda:1", worker=4).name == "cuda:1 (cupy)"
    with pytest.raises(InputError, match="a number below 2"):
        find_device("cuda:2")
    with_devices(monkeypatch, cupy=1, torch=1)
    assert find_device("auto") == ArrayDevice("torch", 0)


def test_a_device_with_wrong_results_is_not_used(monkeypatch):
    with_devices(monkeypatch, torch=1)
    check_arithmetic(NUMPY)
    fetched = ArrayDevice.fetched
    monkeypatch.setattr(devices, "ArrayDevice", lambda library, index: NUMPY)
    # ten bits of a product, as short formats have
    monkeypatch.setattr(ArrayDevice, "fetched", lambda self, array: fetched(self, array) * (1 + 2.0**-11))
    assert find_device("auto") is None
    with pytest.raises(InputError, match=r"products on cpu \(numpy\): expected agreement with NumPy to 1e-5"):
        find_device("cuda")


def test_the_failure_of_a_device_is_reported(monkeypatch):
    with_devices(monkeypatch, torch=1)

    def fail(device):
        raise RuntimeError("no kernel image is available")

    monkeypatch.setattr(devices, "check_arithmetic", fail)
    assert find_device("auto") is None
    with pytest.raises(InputError, match=r"a working accelerator.*no kernel image.*choose cpu"):
        find_device("cuda")


def test_auto_uses_the_processor_if_the_device_has_no_room_or_no_such_method(monkeypatch):
    H = lenslet_psf(1, 5, 15)
    P = Projector(H, (20, 20))
    small = replace(NUMPY, room=10)
    monkeypatch.setattr("lfcal.reconstruct.projectors._device_forecast.find_device", lambda text: small)
    for method in ("auto", "fft"):
        device, found = forecast_on("auto", P._problem(method), method, P.memory_limit)
        assert device is None and found.device is None
    with pytest.raises(InputError, match="memory of"):
        Projector(H, (20, 20), device="cuda")
    with pytest.raises(InputError, match="projection method on cpu"):
        Projector(H, (20, 20), method="fft", device=NUMPY)
