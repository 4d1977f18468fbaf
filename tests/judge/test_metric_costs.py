"""What metrics cost that no fault stands for: measured on this H where that can be, else said to be typical."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.judge import FAULTS, FoundFault, iter_search
from lfcal.judge._cost import Costs, _consistent, iter_costs
from lfcal.judge._metric_costs import as_faults, with_costs
from lfcal.judge.inspection import FAIR, Inspection
from lfcal.judge.quality import QualityReport, inspect
from lfcal.judge.quality.metric import Metric, Reading, judge
from lfcal.psf import PSFMatrix
from tests.judge.common import clean, evidence_of, matrix, plan


def alarm(quality: QualityReport, key: str) -> Metric:
    return replace(quality[key], merit="bad", cost=0.3)


@pytest.fixture(scope="module")
def quality() -> QualityReport:
    return inspect(matrix(clean()), workers=1)


@pytest.mark.long
def test_they_are_measured_where_it_is_known_what_they_do(quality: QualityReport) -> None:
    keys = ("snr", "truncation", "step", "period")
    alarms = {key: alarm(quality, key) for key in keys}
    bad = replace(quality, metrics=tuple(alarms.get(m.key, m) for m in quality.metrics))
    found, cleaned = drain(iter_search(evidence_of(clean())))
    assert not found
    told = dict(as_faults(alarms.values(), cleaned))
    assert set(told) == {"snr", "truncation", "step"}
    costs = drain(iter_costs(cleaned, tuple(told.values()), None))
    assert costs.clean is not None and costs.whole
    out = with_costs(bad, tuple(told), costs, ())
    assert out["snr"].measured and out["snr"].cost == costs.clean
    assert out["truncation"].measured and out["truncation"].cost < 0.1, "tails beyond a cutout of 41 pixels"
    assert out["step"].measured and out["step"].cost < FAIR, "patterns are those of the camera"
    assert not out["period"].measured and out["period"].cost == 0.3
    assert "typical" in out["period"].cost_text and "typical" not in out["snr"].cost_text
    assert [out[key].to_dict()["cost_is"] for key in ("snr", "period")] == ["measured", "typical"]
    whole = Inspection(out, (), len(cleaned), 0.0, "", 0.0, costs.clean, costs.as_it_is)
    assert whole.withdrawn(out["step"]) and not whole.withdrawn(out["period"])
    assert [m.key for m in whole.alarms] == ["period"], "what costs next to nothing is no alarm"


def test_none_costs_more_than_what_h_costs_beside_its_named_faults(quality: QualityReport) -> None:
    bad = replace(quality, metrics=tuple(alarm(quality, m.key) if m.key == "leak" else m for m in quality.metrics))

    def cost(*named: float | None, whole: bool = True) -> Metric:
        return with_costs(bad, ("leak",), Costs(0.01, 0.2, (*named, None), whole), named)["leak"]

    assert cost().cost == pytest.approx(np.sqrt(0.2**2 - 0.01**2)) and cost().measured
    assert cost(0.15).cost == pytest.approx(np.sqrt(0.2**2 - 0.01**2 - 0.15**2))
    assert cost(0.2).cost == pytest.approx(0, abs=1e-9) and cost(0.5).cost == pytest.approx(0, abs=1e-9)
    for unknown in (cost(None), cost(whole=False)):
        assert unknown.cost == 0.3 and not unknown.measured


@pytest.mark.long
def test_light_beyond_the_cutouts_costs_what_larger_ones_show(quality: QualityReport) -> None:
    """Of a cutout that is a third of the shadow most is cut off."""
    found = evidence_of(np.ascontiguousarray(clean()[..., 12:-12, 12:-12]))
    told = dict(as_faults([alarm(quality, "truncation")], found))
    (cost,) = drain(iter_costs(found, tuple(told.values()), None)).costs
    assert cost is not None and cost > 0.1 and plan().cutout == (41, 41)


@pytest.mark.parametrize("many", [120, 3000])
def test_saturated_values_cost_the_light_above_the_top(many: int) -> None:
    """120 of 2 million values, the highest a sixth above the top, were said to cost 0.36: each counted the same."""
    values = clean()
    top = np.partition(values.ravel(), -many)[-many]
    counts = (values >= top).sum((3, 4))
    capped = np.minimum(values, top)
    lost = float(np.linalg.norm(values - capped) / np.linalg.norm(values))
    H = PSFMatrix(capped, depths=plan().depths_um, camera=plan().camera, anchor=plan().anchor, saturated=counts)
    found = inspect(H, workers=1)["saturation"]
    assert found.merit == "bad" and lost / 2 < found.cost < 2 * lost, (found.cost, lost)


def test_costs_never_add_to_more_than_h_as_it_is_costs() -> None:
    """What H costs besides goes to faults whose size a sample told."""
    plain = FoundFault(FAULTS.get("lamp"), "", 9.0, 0.1)
    frames, wide = replace(plain, extent=0.1), replace(plain, wider=1.5)
    both = (plain, replace(plain))
    assert _consistent((0.3, 0.4), both, 0.25) == pytest.approx([0.15, 0.2]), "in squares"
    assert _consistent((0.3, 0.4), both, 0.9) == [0.3, 0.4]
    assert _consistent((0.3, 0.4), (plain, frames), np.hypot(0.3, 0.5)) == pytest.approx([0.3, 0.5])
    assert _consistent((0.0, 0.1), (plain, frames), 9.0) == pytest.approx([0.0, 0.3]), "but not without end"
    assert _consistent((0.2, None), (wide, plain), 0.1) == [0.2, None], "what larger cutouts show is not in H as it is"


def test_no_metric_costs_more_than_a_volume_that_is_all_wrong(quality: QualityReport) -> None:
    spec = quality["scan_order"].spec
    assert judge(spec, (Reading(1.0), Reading(1.0)), plan().shape[:3]).cost == 1.0, "typical: 3.6"
    assert np.isnan(judge(spec, (Reading(),), plan().shape[:3]).cost)
