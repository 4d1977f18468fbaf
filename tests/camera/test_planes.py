"""Depth planes: which a camera sees."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.camera.planes import checked_depths


@pytest.mark.parametrize("depth", [-9000.0, -20000.0, 1e9])
def test_depths_in_the_objective_or_far_from_its_focus_are_refused(depth: float) -> None:
    with pytest.raises(InputError, match=r"within 5000 µm of the focal plane.* got .*choose a plane nearer") as caught:
        checked_depths(preset("lfm_20x05"), (depth,))  # an objective of 10 mm
    assert "\n" not in str(caught.value)


def test_depths_near_the_focus_are_taken_by_the_objective_s_focal_length() -> None:
    camera = preset("lfm_20x05")
    assert checked_depths(camera, (-4900.0, 4900.0)) == (-4900.0, 4900.0)
    # in water a focal length is longer by the index
    immersed = replace(camera, optics=replace(camera.optics, medium_index=1.33))
    assert checked_depths(immersed, (-6500.0,)) == (-6500.0,)


def test_a_wavelength_of_another_unit_is_refused_with_both() -> None:
    with pytest.raises(InputError, match=r"0\.00052; give it in µm, or to --wavelength in nm"):
        replace(preset("lfm_20x05"), wavelength_um=0.00052)
