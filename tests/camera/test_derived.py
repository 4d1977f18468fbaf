"""What follows from a camera is right, and says when it rests on values that were only assumed."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import pytest

from lfcal.base import InputError
from lfcal.camera import Camera, Derived, Marks, derived_of, preset, quantities_of


def table(name: str, **marks: str) -> dict[str, Derived]:
    camera = replace(preset(name), marks=Marks.of({k.replace("__", "."): v for k, v in marks.items()}))
    return {item.label.strip(): item for item in derived_of(camera)}


def test_figures_of_a_lens() -> None:
    found = table("r29")
    assert found["period (x × y)"].value == pytest.approx((54.906, 95.1), abs=1e-3)
    assert found["magnification |M|"].value == pytest.approx(0.25 * (1 + 871.75 / 250e3))
    assert found["step for one pixel"].value == pytest.approx(5.5e6 / (250e3 + 871.75))
    assert found["lens to lenslets"].text == "250 mm"
    optics, lattice = preset("r29").optics, preset("r29").lattice
    lenslets = lattice.gap_um / lattice.pitch_um
    assert found["working f-number"].value == pytest.approx(optics.working_f_number)
    assert found["f-number of the lenslets"].value == pytest.approx(lenslets)
    assert found["micro-image diameter / lenslet pitch"].value == pytest.approx(lenslets / optics.working_f_number)
    assert found["type 1: in focus at v"].value == pytest.approx(3)
    assert not any(item.assumed for item in found.values())


def test_figures_of_a_microscope() -> None:
    found = table("lfm_20x05", lattice__gap_um="assumed")
    assert found["step for one pixel"].value == pytest.approx(125 / 15 / 20)
    assert found["depth of field of the objective"].value == pytest.approx(0.525 / 0.25)
    # a telecentric image does not move with the gap
    assert found["step for one pixel"].assumed == ()


def test_what_rests_on_assumed_values_says_so() -> None:
    found = table("r29", sensor__pixel_um="assumed", sensor__shape="assumed", lattice__pitch_um="derived")
    assert found["step for one pixel"].assumed == ("sensor.pixel_um",)
    assert found["field of view (x × y)"].assumed == ("sensor.pixel_um", "sensor.shape")
    # pitch over pixel is what the maker's file states
    assert found["micro-image pitch"].assumed == ()


def changed(camera: Camera, path: str) -> Camera | None:
    """Return the camera with the value at ``path`` changed by 0.1 %; None if it is no such number."""
    group, _, name = path.rpartition(".")
    part = getattr(camera, group) if group else camera
    value = getattr(part, name)
    if not isinstance(value, float) or not math.isfinite(value) or value == 0:
        return None
    for factor in (0.999, 1.001):
        with suppress(InputError):  # at a bound, only one direction is allowed
            other = replace(part, **{name: value * factor})
            return replace(camera, **{group: other}) if group else other
    return None


@pytest.mark.parametrize("name", ["r29", "lfm_20x05", "bench"])
def test_no_derived_value_is_better_known_than_its_inputs(name: str) -> None:
    camera, seen = preset(name), 0
    for path in (one.path for one in quantities_of(camera)):
        other = changed(camera, path)
        if other is None:
            continue
        marked = derived_of(replace(camera, marks=Marks.of({path: "assumed"})))
        for before, after, row in zip(derived_of(camera), derived_of(other), marked, strict=True):
            # the ratio of pitch to pixel is stated, so lengths in pixels do not depend on the pixel's size
            if before.value != after.value and (path, before.unit) != ("sensor.pixel_um", "px"):
                assert row.assumed == (path,), (before.label, path)
                seen += 1
    assert seen > 10
