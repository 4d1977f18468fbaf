"""Summarise the frames of a target, and their cost compared with a single point, as plain JSON types."""

from __future__ import annotations

from typing import Any

from lfcal.camera import Forecast, RegionPlan
from lfcal.multiplex import CodingVerdict
from lfcal.targets.expected import error_forecast
from lfcal.targets.plan import TargetForecast, TargetPlan, region_points
from lfcal.targets.planning import shown_within
from lfcal.targets.target import target_words

__all__ = ["facts_of_plan"]


def facts_of_plan(
    plan: TargetPlan, cost: TargetForecast, single: Forecast, verdict: CodingVerdict | None, field: RegionPlan | None
) -> dict[str, Any]:
    """Return a summary of a plan, with its coverage, crosstalk, cost and expected errors, as plain JSON types.

    ``cost`` is the forecast for the plan, and ``single`` that for a scan with a single point. ``verdict`` states
    whether showing several offsets together reduces noise (None: no statement). ``field`` contains the regions of the
    field (None: one region).
    """
    planes, errors = [], []
    for z, depth in enumerate(plan.scan.depths_um):
        counts, error = plan.shown(z), error_forecast(plan, z)
        planes.append(
            {
                "depth_um": depth,
                "frames": len(plan.offsets_px[z]),
                "least_frames": plan.least_frames(z),
                "points_a_frame": plan.points_a_frame(z),
                "coverage": float((counts > 0).mean()),
                "mean_repeats": float(counts.mean()),
                "crosstalk": plan.crosstalk[z],
                "coverage_within_pose": None if plan.target.within.known else shown_within(plan, z),
            }
        )
        errors.append({"single_point": error.single, "shown": error.shown, "error": error.error})
    facts = {
        "target": target_words(plan.target),
        "tolerance_px": plan.tolerance_px,
        "tails": plan.tails,
        "planes": planes,
        "frames": cost.frames,
        "hours": cost.hours,
        "readout_hours": cost.readout_hours,
        "single_point": {"frames": single.frames, "hours": single.hours},
        "plan": plan.to_dict(),
        "expected_error": errors,
        "coding": None if verdict is None else verdict.to_dict(),
    }
    if field is not None:
        facts["regions"] = _regions(plan, field, single)
    return facts


def _regions(plan: TargetPlan, field: RegionPlan, single: Forecast) -> dict[str, Any]:
    """Return the number of points in each region, and the frames that a single point would need for all regions."""
    counts = [region_points(plan, field, z) for z in range(len(plan.scan.depths_um))]
    found = [
        {
            "name": name,
            "anchor": field.anchors[k],
            "fewest_points": min((int(one[:, k].min()) for one in counts if len(one)), default=0),
            "points": [int(one[:, k].sum()) for one in counts],
        }
        for k, name in enumerate(field.names)
    ]
    frames = {"frames": len(field) * single.frames, "hours": len(field) * single.hours}
    return {"regions": found, "single_point": frames}
