"""Responses: other wavelengths, blocks of rows, filters, and where they lie."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import convolve
from scipy.signal import convolve2d

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.simulate import PlaneResponse, Sampling, at_wavelength, filtered
from lfcal.simulate.effects import Crosstalk, Estimate, Outlook, PsfEffect
from lfcal.simulate.engines._wave import WavePlane
from lfcal.simulate.scene import seidel
from lfcal.simulate.staging import filter_kernel
from tests.simulate.common import small_camera
from tests.simulate.scenes import camera_scene, relative_error


def path_um(scene, rho):
    """Return the path that the wavefront adds at the rim's share ``rho`` (µm), from its terms of m = 0."""
    zernike = {2: 2 * rho**2 - 1, 4: 6 * rho**4 - 6 * rho**2 + 1, 0: np.ones_like(rho)}
    return scene.wavelength_um * sum(waves * zernike[n] for n, m, waves in scene.wavefront if m == 0)


def test_aberrations_keep_their_path_lengths() -> None:
    scene, rho = camera_scene(4.0, wavefront=seidel(spherical=1.5)), np.linspace(0, 1, 5)
    blue, red = at_wavelength(scene, 0.45), at_wavelength(scene, 0.65)
    assert blue.wavelength_um == 0.45 and red.wavelength_um == 0.65
    for other in (blue, red):
        np.testing.assert_allclose(path_um(other, rho), path_um(scene, rho), rtol=1e-12, atol=1e-12)
    assert blue.wavefront[0][2] > scene.wavefront[0][2] > red.wavefront[0][2]
    assert at_wavelength(scene, scene.wavelength_um).wavefront == scene.wavefront
    # there and back
    back = at_wavelength(blue, scene.wavelength_um)
    np.testing.assert_allclose(back.wavefront, scene.wavefront)


@pytest.mark.long
def test_a_path_is_more_waves_of_blue_light_on_the_sensor() -> None:
    """The response in blue is that of a wavefront of as many more waves, written by hand."""
    scene = camera_scene(4.0, wavefront=((4, 0, 2.0), (2, 2, -0.5)), cutout=(31, 31))
    sampling = Sampling(nodes_per_px=3, margin_px=4)
    found = WavePlane(at_wavelength(scene, 0.44), sampling).point(3.0, 2.0)
    more = camera_scene(4.0, wavelength_um=0.44, wavefront=((4, 0, 2.5), (2, 2, -0.625)), cutout=(31, 31))
    same = camera_scene(4.0, wavelength_um=0.44, wavefront=scene.wavefront, cutout=(31, 31))
    assert relative_error(found, WavePlane(more, sampling).point(3.0, 2.0)) < 1e-6
    assert relative_error(WavePlane(same, sampling).point(3.0, 2.0), found) > 0.05


def test_blocks_of_rows_make_the_whole_and_a_point_lies_at_its_chief_ray() -> None:
    plan = replace(ScanPlan.for_camera(small_camera(), virtual_depths=[3.0], cutout=15), period=(5, 9))
    response = PlaneResponse(plan, 0, (), level="geometric")
    whole = response.rows(range(5), range(3))
    assert whole.any()
    for block, steps in ((2, [2, 4, 5]), (3, [3, 5]), (5, [5])):
        out = np.zeros_like(whole)
        assert list(response.accumulate(out, np.arange(5), np.arange(3), block=block)) == steps
        np.testing.assert_array_equal(out, whole)
    ((row, column, values),) = response.point(1.2, 7.9)
    assert (row, column) == (1, 8) and values.shape == (15, 15)


def test_neighbouring_pixels_share_light_up_to_the_cutout_s_edge() -> None:
    """Brute force, on cutouts a pixel larger on each side: light also comes in from outside the cutout."""
    plan = replace(ScanPlan.for_camera(small_camera(), virtual_depths=[3.0], cutout=15), period=(2, 2))
    share = 0.03
    wide = PlaneResponse(replace(plan, cutout=(17, 17)), 0, (), level="geometric").rows(range(2), range(2))
    expected = np.zeros((2, 2, 15, 15))
    for down, right in itertools.product((-1, 0, 1), repeat=2):
        weight = (share if down else 1 - 2 * share) * (share if right else 1 - 2 * share)
        expected += weight * wide[..., 1 + down : 16 + down, 1 + right : 16 + right]
    found = PlaneResponse(plan, 0, (Crosstalk(share),), level="geometric").rows(range(2), range(2))
    np.testing.assert_allclose(found, expected, atol=1e-6 * expected.max())


def test_patterns_are_convolved_however_many_axes_lead() -> None:
    rng = np.random.default_rng(0)
    for leading in ((), (3,), (2, 3)):
        values, kernel = rng.random((*leading, 5, 7)).astype(np.float32), rng.random((3, 5))
        expected = convolve(values, kernel.reshape(*np.ones_like(leading, int), 3, 5), mode="constant")
        np.testing.assert_allclose(filtered(values, kernel), expected, rtol=1e-5)


def test_filters_of_several_effects_are_multiplied_in_full() -> None:
    """Of other sides than each other and in double precision, as filters are."""
    rng = np.random.default_rng(1)
    kernels = [rng.random(shape) for shape in ((3, 5), (7, 1), (5, 3))]

    @dataclass(frozen=True)
    class Blur(PsfEffect):
        name = title = "blur"
        index: int = 0

        def kernel(self, camera: Camera) -> NDArray[np.float64]:
            return kernels[self.index]

        def estimate(self, outlook: Outlook) -> Estimate:
            return Estimate(0.0, "", 0.0, "none")

    found = filter_kernel([Blur(index=k) for k in range(3)], preset("bench"))
    wanted = convolve2d(convolve2d(kernels[0], kernels[1]), kernels[2])
    assert found is not None and found.shape == wanted.shape == (13, 7)
    np.testing.assert_allclose(found, wanted, rtol=1e-14)
    np.testing.assert_allclose(filtered(kernels[0], kernels[2]), convolve(kernels[0], kernels[2], mode="constant"))
