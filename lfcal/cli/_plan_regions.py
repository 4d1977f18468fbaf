"""``lfcal plan --regions``: several representative regions of the field in one session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from lfcal.base import format_seconds, replace_whole
from lfcal.cli._console import print_json, print_table

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.cli._plan_pace import Pace

__all__ = ["RegionsOption", "plan_regions"]

RegionsOption: TypeAlias = Annotated[
    str,
    typer.Option(
        "--regions",
        help="Several regions of the field, ROWSxCOLUMNS over the sensor, e.g. 3x3: centre, edges, corners.",
    ),
]
"""How many regions, and where."""


def plan_regions(scan: ScanPlan, text: str, pace: Pace, out: Path | None, *, json: bool) -> None:
    """Plan the regions, write the plan where asked, and print where they lie and what they cost."""
    from lfcal.camera import RegionPlan, parse_regions

    one = pace.forecast(scan)
    plan = RegionPlan.spread(scan, parse_regions(text))
    if out is not None:
        with replace_whole(out) as part:
            part.write_text(plan.to_json(), encoding="utf-8")
    facts: dict[str, Any] = {
        "regions": [
            {"name": name, "anchor": plan.anchors[k], "residual_px": plan.residual_px(k)}
            for k, name in enumerate(plan.names)
        ],
        "frames": len(plan) * one.frames,
        "hours": len(plan) * one.hours,
        "readout_hours": None if one.readout_hours is None else len(plan) * one.readout_hours,
        "single_region": {"frames": one.frames, "hours": one.hours},
        "plan": plan.to_dict(),
    }
    if json:
        print_json(facts)
        return
    rows = []
    for found in facts["regions"]:
        (row, column), (down, along) = found["anchor"], found["residual_px"]
        rows.append([found["name"], f"{row:g}, {column:g}", f"{down:+.2f}, {along:+.2f}"])
    ny, nx = scan.period
    title = f"{len(plan)} regions of {ny} x {nx} positions in {len(scan.depths_um)} planes"
    print_table(["region", "anchor (row, column)", "beside the first one's phases (px)"], rows, title=title)
    frames, hours = facts["frames"], 3600 * facts["hours"]
    typer.echo(
        f"{frames} frames, {format_seconds(hours)} in all{pace.note}; one region {format_seconds(3600 * one.hours)}"
    )
    if out is not None:
        typer.echo(f"written: {out}")
