from __future__ import annotations

import re

import pytest

from lfcal.camera import PRESETS, MainLens, ScanPlan, preset
from lfcal_gui.pages.setup import model_scan as plan_form
from lfcal_gui.pages.setup.model_picture import ScanCosts
from lfcal_gui.pages.setup.model_target import PlanSettings


@pytest.mark.parametrize("name", PRESETS)
def test_plan_fields_go_both_ways(name: str) -> None:
    plan = plan_form.default_plan(preset(name))
    for key, value in plan_form.values_of(plan).items():
        if key == "virtual_depths" and not plan.camera.has_lattice:
            assert not value
            continue
        again, error = plan_form.apply_change(plan, key, value)
        assert not error, (key, error)
        assert again is not None and again.shape == plan.shape


def rows_of(plan: ScanPlan, **rates: float) -> list[tuple[str, str]]:
    return ScanCosts.of(plan, PlanSettings(**rates), None, None).rows()  # type: ignore[arg-type]


def test_plan_changes() -> None:
    plan = plan_form.default_plan(preset("bench"))
    changed, _ = plan_form.apply_change(plan, "virtual_depths", "2, 3")
    assert changed is not None and changed.virtual_depths == pytest.approx((2, 3))
    changed, _ = plan_form.apply_change(plan, "stage", "-y,+x,+z")
    assert changed is not None
    assert (changed.stage.right, changed.stage.down, changed.stage.away) == ("-y", "+x", "+z")
    for key, value in (("cutout", "10"), ("virtual_depths", ""), ("exposure", "-1"), ("anchor", "1e6,0")):
        nothing, error = plan_form.apply_change(plan, key, value)
        assert nothing is None and "\n" not in error and error


def test_scan_path_and_forecast() -> None:
    plan = plan_form.default_plan(preset("bench"))
    path = plan_form.scan_path(plan)
    assert len(path) == 19 * 33 and tuple(path[0]) == plan.anchor
    rows = dict(rows_of(plan))
    assert rows["Positions"] == f"{plan.n_positions:,}" and rows["H, float32"].endswith("B")
    assert "Time without readout" in rows and rows["  whole frames at"].endswith("B/s"), "what is not counted is told"
    assert "  moving at 1 mm/s" in rows, "what is assumed is told"
    rows = dict(rows_of(plan, speed=2000.0, frame_rate=10.0))
    assert {"Time", "  reading out", "  moving at 2 mm/s"} <= rows.keys()
    assert isinstance(plan.camera.optics, MainLens)


def test_no_minus_before_a_zero() -> None:
    plan = plan_form.default_plan(preset("lfm_20x05"))
    values = plan_form.values_of(plan)
    shown = [str(value) for value in values.values()]
    assert not [text for text in shown if re.search(r"-0(\.0)?([, ]|$)", text)], shown
    for name in PRESETS:
        told = rows_of(plan_form.default_plan(preset(name)))
        assert "-0.000" not in str(told)
