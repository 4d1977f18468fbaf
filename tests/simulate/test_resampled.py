"""H on the resampled grid, against frames of the same camera on the sensor's own pixels, and against oracles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import fft

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.psf import Cutout
from lfcal.psf.cutout import Gatherer
from lfcal.simulate import PlaneResponse, SimulatedCamera, plan_effects, scene_for, simulate_psf
from lfcal.simulate.engines._debye import debye_field
from tests.simulate.common import difference, long


def cropped(camera: Camera, side: int) -> Camera:
    """Return the camera with a small sensor."""
    return replace(camera, sensor=replace(camera.sensor, shape=(side, side), black_level=0.0))


def from_frames(source: SimulatedCamera, cut: Cutout, position: tuple[int, int]) -> np.ndarray:
    """Return the response of one position of plane 0 as assembly makes it, in units of H."""
    infos = tuple(source.info(k) for k in range(len(source)))
    index = next(k for k, info in enumerate(infos) if tuple(info.position)[1:] == position)
    return Gatherer(source, infos, cut).cut(index).values / source.counts_per_unit(0)


@pytest.mark.parametrize(
    ("name", "options", "cubic"),
    [
        ("lfm_60x12", {"depths_um": [-2.0], "cutout": 71}, 0.07),
        long("lfm_60x12", {"depths_um": [1.5], "cutout": 71}, 0.07),
        long("bench", {"virtual_depths": [4.0], "cutout": 49}, 0.1),
    ],
)
def test_frames_assemble_to_the_direct_h(name: str, options: dict, cubic: float) -> None:
    """What is left is the interpolation: spots are finer than the sensor's pixels resolve."""
    plan = ScanPlan.for_camera(cropped(preset(name), 120), resample=True, **options)
    effects = plan_effects(plan, 0.03).effects
    direct, source = PlaneResponse(plan, 0, effects), SimulatedCamera(plan, effects)
    cut, (ny, nx) = Cutout.for_plan(plan), plan.period
    for position in ((1, 2), (ny - 1, nx - 1)):
        wanted, found = direct.rows(*([p] for p in position))[0, 0], from_frames(source, cut, position)
        assert difference(found, wanted) < cubic
        # two computations, on pixels of two sizes, each within its own tolerance
        assert found.sum() == pytest.approx(wanted.sum(), rel=5e-3)
        # a tenth of a pixel off in any direction is worse
        for off in ((0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1)):
            moved = from_frames(source, replace(cut, anchor=tuple(np.add(plan.anchor, off))), position)
            assert difference(moved, wanted) > 1.3 * difference(found, wanted)
        if name == "lfm_60x12":
            linear = from_frames(source, Cutout.for_plan(plan, interpolation="linear"), position)
            assert difference(linear, wanted) > 2 * difference(found, wanted)


def propagated(plan: ScanPlan, z: int, y: int, x: int, per: int) -> np.ndarray:
    """Return a scalar point's response by one large FFT: field on the array, lenslets' phase, propagation, pixel sums.

    No code of the engines but the Debye integral on the array, which is compared with twenty digits elsewhere.
    """
    camera = plan.camera
    lam, pitch, gap = camera.wavelength_um, camera.lattice.pitch_um, camera.lattice.gap_um
    fy, fx = plan.resample_factors
    step = camera.sensor.pixel_um / fy / per
    n = fft.next_fast_len(int(3 * plan.cutout[0] * per))
    at = (np.arange(n) - n // 2) * step
    row, column = plan.lattice_anchor
    source = (row + y / fy) * camera.sensor.pixel_um, (column + x / fx) * camera.sensor.pixel_um
    r = np.hypot(at[:, None], at[None, :])
    radii = np.linspace(0, r.max(), 4000)
    values = debye_field(scene_for(plan, z, ()), radii)
    field = np.interp(r, radii, values.real) + 1j * np.interp(r, radii, values.imag)
    local = [(at + s + pitch / 2) % pitch - pitch / 2 for s in source]
    lens = [np.exp(-1j * np.pi * v**2 / (lam * camera.lattice.types[0].focal_length_um)) for v in local]
    f = fft.fftfreq(n, step)
    carry = np.exp(-1j * np.pi * lam * gap * f**2)
    light = np.abs(fft.ifft2(fft.fft2(field * lens[0][:, None] * lens[1]) * carry[:, None] * carry)) ** 2 * step**2
    nt, ns = plan.cutout
    top, left = (n // 2 - per * (m // 2) - per // 2 for m in (nt, ns))
    return light[top : top + nt * per, left : left + ns * per].reshape(nt, per, ns, per).sum(axis=(1, 3))


@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "z"), [("lfm_20x05", -12.0), ("lfm_60x12", -1.5), ("lfm_60x12", 2.0)])
def test_against_one_large_transform(name: str, z: float) -> None:
    plan = ScanPlan.for_camera(cropped(preset(name), 120), depths_um=[z], cutout=61, resample=True)
    effects = plan_effects(plan, 0.02, {"vectorial": "off"})
    found = simulate_psf(plan, effects, tolerance=0.02)
    for y, x in ((0, 0), (4, 11)):
        wanted = propagated(plan, 0, y, x, 9)
        assert difference(found.plane(0)[y, x], wanted) < 0.02
        assert difference(found.plane(0)[x, y], wanted) > 0.1 or x == y


def test_h_repeats_over_the_resampled_period() -> None:
    plan = ScanPlan.for_camera(cropped(preset("lfm_60x12"), 120), depths_um=[2.0], cutout=61, resample=True)
    response = PlaneResponse(plan, 0, plan_effects(plan, 0.03).effects)
    one, next_one = response.rows([3, 18], [5])[:, 0]
    assert difference(next_one, one) < 1e-5
    uneven = PlaneResponse(replace(plan, resample=False), 0, plan_effects(plan, 0.03).effects)
    one, next_one = uneven.rows([3, 18], [5])[:, 0]
    assert difference(next_one, one) > 0.02
