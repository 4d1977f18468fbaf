"""Scan plans for programs that record frames themselves: a list of stage positions, or a sequence of useq-schema.

useq-schema (https://pymmcore-plus.github.io/useq-schema/) describes acquisitions for pymmcore-plus and the programs
based on it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from lfcal.base import InputError
from lfcal.camera.plan import ScanPlan

__all__ = ["stage_table", "useq_sequence"]

COLUMNS = ("file", "x_um", "y_um", "z_um", "exposure_s")


def stage_table(plan: ScanPlan, positions: ArrayLike | None = None) -> str:
    """Return the stage position and exposure time of every frame as a CSV table, in scan order.

    The column ``file`` is a name for the frame, without suffix. If the frames have these names, the table is a list of
    them for `lfcal.frames.open_frames`.

    Parameters
    ----------
    plan
        The plan.
    positions
        Positions (z, y, x) to record, ``(n, 3)``. None: all.
    """
    rows = [",".join(COLUMNS)]
    for name, z, place in _places(plan, positions):
        for k in range(plan.frames_averaged):
            file = name if plan.frames_averaged == 1 else f"{name}_{k}"
            rows.append(",".join((file, *(f"{at:.4f}" for at in place), f"{plan.exposures[z]:g}")))
    return "\n".join(rows) + "\n"


def useq_sequence(plan: ScanPlan, positions: ArrayLike | None = None) -> str:
    """Return the plan as JSON text of an ``MDASequence`` of useq-schema, whose positions are in scan order.

    useq-schema states exposure times for channels only, which depend on the microscope. The exposure time of the plan
    is in the metadata.

    Parameters
    ----------
    plan, positions
        As in `stage_table`.

    Raises
    ------
    InputError
        If the planes differ in exposure time.
    """
    if len(set(plan.exposures)) > 1:
        got = f"{len(set(plan.exposures))} different ones"
        raise InputError.expected("exposure time of a useq sequence", "one for all planes", got, "write a CSV table")
    # a tenth of a nanometre is below the resolution of any stage
    placed = [(name, np.round(place, 4).tolist()) for name, _, place in _places(plan, positions)]
    sequence = {
        "axis_order": "ptgzc",
        "stage_positions": [dict(zip(("name", "x", "y", "z"), (name, *place), strict=True)) for name, place in placed],
        "metadata": {"lfcal": {"exposure_s": plan.exposures[0], "settle_s": plan.settle_s}},
    }
    if plan.frames_averaged > 1:
        sequence["time_plan"] = {"interval": 0, "loops": plan.frames_averaged}
    return json.dumps(sequence, indent=1)


def _places(plan: ScanPlan, positions: ArrayLike | None) -> Iterator[tuple[str, int, tuple[float, ...]]]:
    """Yield name, plane and stage coordinates (x, y, z; µm) of each position in scan order."""
    order = plan.order_indices() if positions is None else plan.in_scan_order(positions)
    for (z, y, x), place in zip(order.tolist(), plan.stage_um(order).tolist(), strict=True):
        yield f"z{z:03d}_y{y:03d}_x{x:03d}", z, tuple(place)
