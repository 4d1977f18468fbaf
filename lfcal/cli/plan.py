"""``lfcal plan``: plan a scan, and show its positions, time, disk space and memory."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from lfcal.base import format_bytes, format_length, format_seconds
from lfcal.cli._task_command import add_task
from lfcal.tasks import WITHOUT_READOUT, RegionsPlanned, ScanPlanned, task_set

if TYPE_CHECKING:
    from lfcal.camera import Forecast, ScanPlan


def register(app: typer.Typer) -> None:
    """Add ``plan`` to the app."""
    add_task(app, task_set("plan"), show, parts=True)


def show(made: tuple[ScanPlanned | RegionsPlanned]) -> None:
    """Print the plan with its cost."""
    from lfcal.cli._console import print_table

    (one,) = made
    if isinstance(one, RegionsPlanned):
        _show_regions(one)
    else:
        rows = _rows(one)
        if one.half is not None:
            ny, nx = one.plan.period
            same = f"rows 0 to {ny // 2 - 1}; the rest is the same, {ny // 2}, {nx // 2} px away"
            rows.append(["half-cell scan", same])
        print_table(["scan plan", "value"], rows)
    for path in one.files:
        typer.echo(f"written: {path}")


def _show_regions(one: RegionsPlanned) -> None:
    from lfcal.cli._console import print_table

    plan, facts = one.plan, one.to_dict()
    rows = []
    for found in facts["regions"]:
        (row, column), (down, along) = found["anchor"], found["residual_px"]
        rows.append([found["name"], f"{row:g}, {column:g}", f"{down:+.2f}, {along:+.2f}"])
    ny, nx = plan.scan.period
    title = f"{len(plan)} regions of {ny} x {nx} positions in {len(plan.scan.depths_um)} planes"
    print_table(["region", "anchor (row, column)", "beside the first one's phases (px)"], rows, title=title)
    hours, single = format_seconds(3600 * facts["hours"]), format_seconds(3600 * one.single.hours)
    typer.echo(f"{facts['frames']} frames, {hours} in all{one.pace.note}; one region {single}")


def _rests(plan: ScanPlan, paths: tuple[str, ...]) -> str:
    """Return the words for a figure that depends on assumed values among ``paths``; empty if none is assumed."""
    from lfcal.camera import assumed_of

    return " (from assumed values)" if assumed_of(plan.camera, paths) else ""


def _rows(one: ScanPlanned) -> list[list[str]]:
    from lfcal.camera import DEPTH, STEP, WHOLE_FRAMES

    plan, forecast, speed = one.plan, one.forecast, one.pace.stage_um_per_s
    nz, ny, nx, nt, ns = plan.shape
    camera, (py, px), (ry, rx) = plan.camera, plan.camera.period_px, plan.period_residual_px
    steps = [plan.step_um(z)[1] for z in range(nz)]
    depths, virtual = plan.depths_um, plan.virtual_depths
    where = plan.lattice_anchor
    rests = {name: _rests(plan, DEPTH) if name in one.computed else "" for name in ("depths", "virtual depths")}
    return [
        ["camera", f"{camera.name}: {camera.lattice.kind}, {len(camera.lattice.types)} lens type(s)"],
        ["cell of the lenslet array (x × y)", f"{px:.3f} × {py:.3f} px"],
        ["positions per plane (x × y)", f"{nx} × {ny} = {nx * ny}"],
        ["residual over one period (x, y)", f"{rx:+.3f}, {ry:+.3f} px{_cure(plan)}"],
        ["tilt over one period", f"{plan.tilt_residual_px:+.3f} px"],
        ["planes", f"{nz}"],
        ["  object-space depth", _span([format_length(z) for z in depths]) + rests["depths"]],
        ["  virtual depth", _span([f"{v:z.4g}" for v in virtual]) + rests["virtual depths"]],
        ["  lateral step (x)", _span([format_length(step) for step in steps]) + _rests(plan, STEP)],
        ["cutout (rows × columns)", f"{nt} × {ns} px"],
        ["image of position y = x = 0", f"row {plan.anchor[0]:g}, column {plan.anchor[1]:g}"],
        ["  from the nearest type-0 lenslet", f"{where[0]:+.2f}, {where[1]:+.2f} px (rows, columns)"],
        ["order", plan.order],
        ["source positions", f"{forecast.positions}"],
        ["frames", f"{forecast.frames} ({plan.frames_averaged} per position)"],
        ["time in all", format_seconds(forecast.hours * 3600) + _unread(forecast)],
        ["  exposing", format_seconds(forecast.exposure_hours * 3600)],
        *_reading(forecast),
        ["  settling", f"{format_seconds(forecast.settle_hours * 3600)} ({format_seconds(plan.settle_s)} per move)"],
        ["  moving", f"{format_seconds(forecast.move_hours * 3600)} at {format_length(speed)}/s"],
        ["whole frames on disk", format_bytes(forecast.frame_bytes) + _rests(plan, WHOLE_FRAMES)],
        ["cutouts on disk (uint16)", format_bytes(forecast.cutout_bytes)],
        ["H, float32", f"{format_bytes(forecast.h_float32_bytes)} before compression"],
        ["H, rounded", f"{format_bytes(forecast.h_rounded_bytes)} at most"],
        ["HT, where it is exported (float32)", format_bytes(forecast.ht_float32_bytes)],
        ["memory to assemble (two planes)", format_bytes(forecast.assembly_bytes)],
    ]


def _reading(forecast: Forecast) -> list[list[str]]:
    """Return the row of the readout, where it is known."""
    hours = forecast.readout_hours
    if hours is None:
        return []
    rate = forecast.frames / hours / 3600
    return [["  reading out", f"{format_seconds(hours * 3600)} at {rate:.4g} frames/s"]]


def _unread(forecast: Forecast) -> str:
    """Return what is to be said of a time in which no readout is counted."""
    if forecast.readout_hours is not None:
        return ""
    return f" {WITHOUT_READOUT}: the camera would deliver {format_bytes(forecast.bytes_per_s)}/s"


def _cure(plan: ScanPlan) -> str:
    if plan.resample:
        fy, fx = plan.resample_factors
        return f", removed: frames are resampled × {fx:.6f}, {fy:.6f}"
    worst = max(map(abs, plan.period_residual_px))
    return " (--resample removes it)" if worst > 0.005 else ""


def _span(values: list[str]) -> str:
    return values[0] if len(values) == 1 else f"{values[0]} … {values[-1]}"
