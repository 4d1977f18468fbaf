"""What the window's devices show where nothing else was asked for."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.acquire.setup import iter_stage_fit
from lfcal.acquire.spots import find_spot
from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.simulate import sample_session
from lfcal_gui.pages.acquire.model_station import open_station


@pytest.fixture(scope="module")
def plan() -> ScanPlan:
    return ScanPlan.from_json((sample_session() / "plan.json").read_text())


def seen(plan: ScanPlan, **options: str) -> np.ndarray:
    """Return the live frame of a source on the axis, in the first plane."""
    station = open_station(plan, "sim", options)
    station.move((0.0, 0.0, plan.depths_um[0]))
    frame = station.look(plan.exposures[0], plan).frame
    station.close()
    assert frame is not None
    return np.asarray(frame.data)


def test_the_simulator_shows_a_plenoptic_image_unless_the_quick_pattern_is_asked_for(plan: ScanPlan) -> None:
    found = seen(plan)
    np.testing.assert_array_equal(found, seen(plan, optics="auto", effects="auto"))
    assert not np.array_equal(found, seen(plan, optics="pattern"))
    assert find_spot(found).snr > 100


def test_light_that_ideal_optics_focus_into_single_pixels_is_not_found(plan: ScanPlan) -> None:
    with pytest.raises(InputError, match="no significant light"):
        find_spot(seen(plan, optics="auto"))


def test_the_stage_is_measured_with_what_the_simulator_shows(plan: ScanPlan) -> None:
    station = open_station(plan, "sim", {})
    fit = drain(station.use(iter_stage_fit(station.rig, plan)))
    station.close()
    assert fit.scale == pytest.approx((1, 1), abs=0.02)
