"""One iris seen from all depths: the lenslets' blur, the same in all planes, is no curvature of its blades."""

from __future__ import annotations

import pytest

from lfcal.judge import inspect
from lfcal.psf import PSFMatrix
from lfcal.psf.aperture import expected_aperture
from tests.judge.quality.scenes import Scene, hexagonal, recorded, single


@pytest.mark.parametrize(("scene", "blades", "curvature"), [(hexagonal, 7, 0.0), (single, 9, 0.3)])
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
