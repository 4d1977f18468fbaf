"""Several regions of the field, as assemble, inspect, verify and simulate take them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError

if TYPE_CHECKING:
    from lfcal.camera import RegionPlan, ScanPlan

__all__ = ["Made", "make_regions", "show_loss"]

Made = Callable[["ScanPlan", str, Path], dict[str, Any]]
"""Makes H of one region, given its plan, its name and the file; returns what is told of it."""


def make_regions(plan: RegionPlan, out: Path, made: Made, given: dict[str, bool], **saving: Any) -> dict[str, Any]:
    """Make H of each region and write all to one file; return what is told, by region.

    Raises
    ------
    InputError
        If one of the options ``given`` is of one region.
    """
    from lfcal.campaign import save_parts, temporary_parts

    named = [name for name, there in given.items() if there]
    if named:
        raise InputError(f"{named[0]}: is of one region; leave it out with a plan of several")
    with temporary_parts(out, plan.names) as parts:
        told = {}
        for k, name in enumerate(plan.names):
            facts = made(plan.plan(k), name, parts[name])
            # its file is gone when all are one
            told[name] = {key: value for key, value in facts.items() if key not in ("path", "out")}
        save_parts(parts, out, **saving)
    return {"out": out, "regions": told, "file_bytes": out.stat().st_size}


def show_loss(loss: Any) -> None:
    """Print it: the number of each region, and the worst."""
    from lfcal.base import format_share
    from lfcal.cli._console import print_table

    rows = [
        [name, f"{row:g}, {column:g}", format_share(error), f"{shift:.2f}"]
        for name, (row, column), error, shift in zip(
            loss.names, loss.anchors.tolist(), loss.losses.tolist(), loss.shift_px.tolist(), strict=True
        )
    ]
    title = f"regions: patterns against those of {loss.names[0]}"
    print_table(["region", "anchor (row, column)", "periodicity loss", "centroid shift (px rms)"], rows, title=title)
    typer.echo(
        f"where {loss.names[0]} stands for the whole field, patterns are {format_share(loss.worst)} off at worst"
    )
