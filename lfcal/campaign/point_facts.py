"""What a target's frames say of themselves in numbers: for H's provenance, which the metrics of quality read."""

from __future__ import annotations

from typing import Any

import numpy as np

from lfcal.base import plain
from lfcal.campaign.points import Points

__all__ = ["target_facts"]

DOUBTFUL = 0.6
"""Confidence below which a label is doubtful."""

MOST = 20
"""Mistakes that are kept."""


def target_facts(points: Points) -> dict[str, Any]:
    """Return what was found of a target as plain JSON types.

    ``crosstalk`` is the most light of neighbours in a cutout: the plan's, of equally bright holes, times how much
    brighter than its own hole the brightest neighbour is. ``stage_px`` is how far frames lie beside where the plan
    moved them (rms), ``pose_rms_px`` how far holes' light lies beside the lattice, ``doubtful`` the share of labels
    that are not certain.
    """
    found = list(points.found.values())
    confidence = np.concatenate([one.confidence for one in found])
    wrong = sum(len(m.holes) for one in found for m in one.mistakes if m.kind == "displaced")
    usual = np.concatenate([one.light / np.median(one.light) for one in found])
    return {
        "points": len(points),
        "frames": len(found),
        "crosstalk": max(points.plan.crosstalk) * _brighter(points),
        "brightness_spread": float(1.4826 * np.median(np.abs(usual - 1))),
        "pose_rms_px": float(np.median([one.fit.rms_px for one in found])),
        "stage_px": _beside(points),
        "doubtful": float(((confidence < DOUBTFUL).sum() + wrong) / len(confidence)),
        "missing": max(sum(len(m.holes) for m in one.mistakes if m.kind.startswith("missing")) for one in found),
        "pose": plain(found[0].fit.pose),
        "pose_sigma": plain(found[0].fit.sigma),
        "scale": list(found[0].fit.scale),
        "distortion": found[0].fit.bend,
        "mistakes": [{"kind": m.kind, "says": m.says, "frames": n} for m, n in points.mistakes[:MOST]],
    }


def _brighter(points: Points) -> float:
    """Return how much brighter than its own hole a neighbour is at most."""
    most = 1.0
    for one in points.found.values():
        at = {tuple(hole): light for hole, light in zip(one.holes.tolist(), one.light.tolist(), strict=True)}
        for (row, column), light in at.items():
            beside = [at.get((row + a, column + b), 0.0) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
            most = max(most, max(beside) / max(light, 1e-9))
    return most


def _beside(points: Points) -> float:
    """Return how far frames lie beside their plan, but for what all of a plane share (rms, pixels)."""
    scan = points.plan.scan
    away: dict[int, list[tuple[float, float]]] = {}
    for k, one in points.found.items():
        z = int(points.z[points.frame == k][0]) if (points.frame == k).any() else 0
        step = scan.camera.step_um(scan.depths_um[z])
        # the prior of a pose is where this frame was planned
        row, column = one.moved_px
        away.setdefault(z, []).append((one.fit.pose.down_um / step - row, one.fit.pose.right_um / step - column))
    squares = [np.square(np.array(own) - np.mean(own, axis=0)).sum(1) for own in away.values()]
    return float(np.sqrt(np.concatenate(squares).mean()))
