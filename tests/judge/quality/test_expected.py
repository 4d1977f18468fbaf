"""Light that the diffraction of the camera explains is no stray light; other light is."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j0, j1

from lfcal.camera import ScanPlan, preset
from lfcal.judge import inspect
from lfcal.judge.quality._expected import _convolved, _footprint, _Grid, expected_sum
from lfcal.judge.quality._sums import edge_light
from lfcal.psf import PSFMatrix
from lfcal.psf.aperture import expected_aperture
from lfcal.simulate import simulate_psf
from tests.judge.quality.scenes import Scene, hexagonal, recorded, single


def test_a_focused_pupil_has_the_tail_of_airy() -> None:
    """Far outside, the hexagonal camera's native plane keeps what Airy's formula leaves of pupil and lenslet."""
    camera = preset("r29")
    camera = replace(camera, lattice=replace(camera.lattice, clear_um=60.0))
    shown = expected_sum(camera, camera.depth_of(0.0), (301, 301))
    y, x = np.indices(shown.shape) - 150
    f_numbers = camera.optics.working_f_number, camera.lattice.gap_um / 60.0

    def beyond(r_um: float) -> float:
        v = [np.pi * r_um / (camera.wavelength_um * n) for n in f_numbers]
        return sum(float(j0(a) ** 2 + j1(a) ** 2) for a in v)

    # the square's corners hold the same as a disc in between: both ends by Airy
    ring = (np.hypot(y, x) > 80) & (np.hypot(y, x) <= 150)
    means = [np.mean([beyond((r + d) * camera.sensor.pixel_um) for d in np.linspace(-4, 4, 41)]) for r in (80, 150)]
    assert shown[ring].sum() == pytest.approx(means[0] - means[1], rel=0.25)
    assert 0.9 < shown.sum() < 1.0001


def test_a_convolution_is_as_large_as_its_pictures() -> None:
    one, other = np.random.default_rng(0).random((2, 5, 9))
    wide = np.pad(other, ((4, 4), (8, 8)))
    # straight from the definition, about the middle pixel
    wanted = [[(one * wide[2 + y : 7 + y, 4 + x : 13 + x][::-1, ::-1]).sum() for x in range(9)] for y in range(5)]
    np.testing.assert_allclose(_convolved(one, other), wanted, rtol=1e-12)


@functools.cache
def simulated(name: str = "lfm_20x05", depths: tuple[float, ...] = (-22.0, 0.0, 12.0), side: int = 81) -> PSFMatrix:
    camera = preset(name)
    plan = ScanPlan.for_camera(camera, depths_um=depths, cutout=side, resample=name == "lfm_60x12")
    return simulate_psf(plan, tolerance=0.05)


def with_stray(share: float, H: PSFMatrix) -> PSFMatrix:
    """Add a broad ghost with this share of each pattern's light next to the pattern."""
    y, x = np.indices(H.cutout)
    ghost = np.exp(-((y - 62) ** 2 + (x - 18) ** 2) / (2 * 3.0**2))
    values = np.stack([H.plane(z) for z in range(len(H))]).astype(np.float64)
    values += share * values.sum((3, 4), keepdims=True) * ghost / ghost.sum()
    # counts of a camera, with its noise
    values *= 30_000 / values.max()
    values += np.random.default_rng(3).normal(0, 3, values.shape)
    given = {"depths": H.depths, "camera": H.camera, "anchor": H.anchor, "provenance": H.provenance}
    return PSFMatrix(values.astype(np.float32), **given)


@pytest.mark.long
@pytest.mark.parametrize(("name", "depths"), [("lfm_20x05", (-22.0, 0.0, 12.0)), ("lfm_60x12", (0.0,))])
@pytest.mark.parametrize(("share", "merits"), [(0.0, {"good"}), (0.02, {"fair", "bad"})])
def test_only_unexplained_light_is_stray(name: str, depths: tuple[float, ...], share: float, merits: set[str]) -> None:
    found = inspect(with_stray(share, simulated(name, depths)))
    assert found["leak"].merit in merits
    assert name == "lfm_60x12" or (found["background"].merit == "good" and found["depth"].merit != "bad")


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "depths"), [("lfm_60x12", (-2.0, -1.0, 0.0, 1.0, 2.0)), ("lfm_20x05", (-22.0, -10.0, 0.0, 12.0, 22.0))]
)
def test_the_expected_share_is_a_little_less_than_that_of_waves(name: str, depths: tuple[float, ...]) -> None:
    """As `docs/modelling.md` says it: a quarter of itself, or 0.6 % of the light where that is more."""
    H = simulated(name, depths, 101)
    for z, depth in enumerate(depths):
        shown = edge_light(H.plane(z).astype(float).mean((0, 1))).leak
        assert H.camera is not None
        expected = edge_light(expected_sum(H.camera, depth, H.cutout, H.pixel_scale)).leak
        assert -max(0.25 * shown, 0.6) < expected - shown < 0.0


@pytest.mark.long
def test_a_microscope_has_its_f_number_and_no_blades() -> None:
    found = inspect(with_stray(0.0, simulated()))
    assert found.f_number is not None
    assert found.f_number.value == pytest.approx(20.0, rel=0.06)
    assert not any(a.confident for a in found.apertures)
    assert all("blades" not in a.describe() for a in found.apertures)
    assert found.apertures[1].refusal == "in focus"


@pytest.mark.parametrize(("clear", "second"), [(1.0, 1 / 8), (2 / np.sqrt(3), 5 / 36)])
def test_lenslets_without_gaps_spread_light_over_their_cells(clear: float, second: float) -> None:
    """Mean square radius, in pitches: of a disc 1/8, of a hexagon 5/36; a disc from corner to corner would have 1/6."""
    bench = preset("bench")
    lattice = replace(bench.lattice, clear_um=clear * bench.lattice.pitch_um)
    scale = float(np.mean([lattice.gap_um / kind.focal_length_um for kind in lattice.types]))
    grid = _Grid((101, 101), (1.0, 1.0))
    light = _footprint(replace(bench, lattice=lattice), grid)
    y, x = grid.axes()
    found = (light * (y[:, None] ** 2 + x**2)).sum() - 1 / 6  # less that of a pixel
    assert light.sum() == pytest.approx(1) and found == pytest.approx(
        second * (scale * lattice.pitch_um) ** 2, rel=0.01
    )


# -- one iris seen from all depths -----------------------------------------------------------------------
@pytest.mark.parametrize(
    ("scene", "blades", "curvature"), [pytest.param(hexagonal, 7, 0.0, marks=pytest.mark.long), (single, 9, 0.3)]
)
def test_all_planes_show_one_iris(scene, blades: int, curvature: float) -> None:
    made: Scene = scene()
    H = PSFMatrix(recorded(made.planes), depths=made.depths, camera=made.camera)
    report = inspect(H)
    assert report.iris is not None and report.iris.confident
    assert report.iris.blades == blades
    assert abs(report.iris.curvature - curvature) < 3 * report.iris.curvature_sigma < 0.5
    for z, aperture in enumerate(report.apertures):
        # no plane says anything wrong, whatever it does not say
        if aperture.confident:
            assert aperture.blades == blades
            assert abs(aperture.curvature - curvature) < 3 * aperture.curvature_sigma
            wanted = expected_aperture(made.camera, float(made.depths[z]), H.cutout)
            assert wanted is not None and aperture.diameter_px == pytest.approx(wanted.diameter_px, rel=0.08)
    assert report.to_dict()["iris"] is report.iris
    assert report.f_number is not None
    assert abs(report.f_number.value - 4.8) < 3 * report.f_number.standard_error
