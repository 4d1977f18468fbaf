"""``lfcal simulate`` of a plan of regions: each at its own place of the field."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from lfcal.camera import RegionPlan, ScanPlan
from lfcal.cli import main
from lfcal.judge.region_loss import region_loss
from lfcal.psf import open_psf, regions_of
from lfcal.simulate import plan_effects, simulate_psf
from lfcal.simulate.effects.described import parse_effects
from tests.targets.common import small

EFFECT = "field_curvature=2mm"


@pytest.mark.long
def test_regions_differ_by_the_effects_of_the_field(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = ScanPlan.for_camera(small(200), virtual_depths=(4.0,), cutout=31)
    plan = RegionPlan.spread(scan, (1, 3))
    (tmp_path / "plan.json").write_text(plan.to_json())
    out = tmp_path / "H.h5"
    words = ["simulate", tmp_path / "plan.json", "-o", out, "--effect", EFFECT, "--tolerance", "0.1", "--json"]
    monkeypatch.setattr(sys, "argv", ["lfcal", *map(str, words)])
    with pytest.raises(SystemExit) as stop:
        main()
    told = json.loads(capsys.readouterr().out)
    assert stop.value.code == 0 and list(told["regions"]) == list(plan.names) == list(regions_of(out))
    loss = region_loss(out)
    assert loss.losses[0] == 0 and loss.losses[1:].min() > 0.01
    own = plan.plan(2)
    settings, given = parse_effects([EFFECT])
    alone = simulate_psf(own, plan_effects(own, 0.1, settings, effects=given), tolerance=0.1)
    with open_psf(out, region=plan.names[2]) as stored:
        assert stored.anchor == own.anchor
        np.testing.assert_allclose(stored.plane(0), alone.plane(0), atol=1e-5 * alone.plane(0).max())


def test_options_of_one_region_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = ScanPlan.for_camera(small(200), virtual_depths=(4.0,), cutout=31)
    (tmp_path / "plan.json").write_text(RegionPlan.spread(scan, (1, 3)).to_json())
    for words in (("--frames", "frames"), ("-o", "H.h5", "--progressive"), ("-o", "H.h5", "--cutout", "21")):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["lfcal", "simulate", "plan.json", *words])
        with pytest.raises(SystemExit) as stop:
            main()
        assert stop.value.code == 2 and "leave" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["plan.json"]
