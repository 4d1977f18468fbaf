from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gui.pages.plan.model import default_plan
from gui.pages.simulate.model import (
    Z_STEPS,
    SimulateSettings,
    depth_of,
    iter_simulation,
    preview,
    tolerance_of,
    tolerance_step,
    verdict_of,
)
from lfcal.camera import ScanPlan, preset
from lfcal.errors import InputError
from lfcal.progress import drain


def small_plan() -> ScanPlan:
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[2.5, 3.0], cutout=41)
    return replace(plan, period=(2, 2))


def test_overrides() -> None:
    settings = SimulateSettings().with_override("coma", "on").with_override("shot", "off")
    assert settings.override("coma") == "on" and settings.override("stray") == "auto"
    assert settings.with_override("coma", "auto").overrides == (("shot", "off"),)


@pytest.mark.parametrize("changes", [{"tolerance": 0.0}, {"level": "magic"}, {"overrides": (("coma", "maybe"),)}])
def test_settings_that_cannot_be(changes: dict[str, object]) -> None:
    with pytest.raises(InputError):
        SimulateSettings(**changes)  # type: ignore[arg-type]


def test_tolerance_steps_and_previews() -> None:
    for step in (0, 17, 60):
        assert tolerance_step(tolerance_of(step)) == step
    plan = default_plan(preset("bench"))
    for z in (plan.depths_um[0], plan.depths_um[-1], -plan.depths_um[0]):
        image = preview(plan, z, (), "geometric", 0.05)
        assert image.shape == plan.cutout and np.isfinite(image).all()


def test_the_previews_depth_goes_from_plane_to_plane() -> None:
    plan = small_plan()
    low, high = sorted(plan.depths_um)
    assert depth_of(plan, 0) == low and depth_of(plan, Z_STEPS) == pytest.approx(high)
    one = replace(plan, depths_um=plan.depths_um[:1], exposure_s=plan.exposures[0])
    assert depth_of(one, Z_STEPS // 2) == pytest.approx(plan.depths_um[0])


def test_a_verdict_for_another_question_is_not_used(tmp_path: Path) -> None:
    plan = small_plan()
    asked = SimulateSettings(0.3, "geometric", (("vignetting", "on"),))
    stale = verdict_of(plan, SimulateSettings(0.3, "geometric", (("vignetting", "off"),)))
    right = verdict_of(plan, asked)
    assert right.fits(plan, asked) and not stale.fits(plan, asked) and not right.fits(None, asked)
    assert {e.name for e in stale.effects} != {e.name for e in right.effects}
    found = []
    for k, verdict in enumerate((stale, right, None)):
        with drain(iter_simulation(plan, asked, str(tmp_path / f"{k}.h5"), verdict)) as matrix:
            found.append([effect["name"] for effect in matrix.provenance["simulated"]["effects"]])
    assert found[0] == found[1] == found[2] == [e.name for e in right.effects]
