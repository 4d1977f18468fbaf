"""``lfcal plan``: plan a scan, and show its positions, time, disk space and memory."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import typer

from lfcal.base import format_bytes, format_length, format_seconds, format_share
from lfcal.cli._console import print_table, print_written
from lfcal.tasks import WITHOUT_READOUT, Planned

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan


def show(made: tuple[Planned]) -> None:
    """Print the plan of a scan or of regions with its cost, and the file."""
    (one,) = made
    if "regions" in one.facts:
        _show_regions(one)
    else:
        print_table(["scan plan", "value"], _rows(one))
    print_written(*one.task.files("out"))


def _show_regions(one: Planned) -> None:
    facts, scan = one.facts, one.plan.scan
    rows = []
    for found in facts["regions"]:
        (row, column), (down, along) = found["anchor"], found["residual_px"]
        rows.append([found["name"], f"{row:g}, {column:g}", f"{down:+.2f}, {along:+.2f}"])
    ny, nx = scan.period
    title = f"{len(rows)} regions of {ny} x {nx} positions in {len(scan.depths_um)} planes"
    print_table(["region", "anchor (row, column)", "phase relative to the first region (px)"], rows, title=title)
    hours, single = format_seconds(3600 * facts["hours"]), format_seconds(3600 * one.forecast.hours)
    typer.echo(f"{facts['frames']} frames, {hours} in all{one.task.unread}; one region {single}")


def _rests(plan: ScanPlan, paths: tuple[str, ...]) -> str:
    """Return a remark for a value that depends on assumed values among ``paths``; empty if it does not."""
    from lfcal.camera import assumed_of

    return " (from assumed values)" if assumed_of(plan.camera, paths) else ""


def _rows(one: Planned) -> list[list[str]]:
    from lfcal.camera import DEPTH, STEP, WHOLE_FRAMES

    plan: ScanPlan = one.plan
    forecast, task = one.forecast, one.task
    nz, ny, nx, nt, ns = plan.shape
    row, column = plan.lattice_anchor
    steps = [format_length(plan.step_um(z)[1]) for z in range(nz)]
    depths, virtual = [format_length(z) for z in plan.depths_um], [f"{v:z.4g}" for v in plan.virtual_depths]
    computed = _rests(plan, DEPTH)
    readout = forecast.readout_hours
    rate = f"{format_bytes(forecast.bytes_per_s)}/s"
    unread = f" {WITHOUT_READOUT}: the camera would deliver {rate}" if readout is None else ""
    half = one.facts["half_cell"] is not None
    return [
        *_array(plan),
        ["planes", f"{nz}"],
        ["  object-space depth", _span(depths) + ("" if task.depths else computed)],
        *([["  virtual depth", _span(virtual) + ("" if task.virtual_depths else computed)]] if virtual else []),
        ["  lateral step (x)", _span(steps) + _rests(plan, STEP)],
        ["cutout (rows × columns)", f"{nt} × {ns} px"],
        ["image of position y = x = 0", f"row {plan.anchor[0]:g}, column {plan.anchor[1]:g}"],
        [_from(plan), f"{row:+.2f}, {column:+.2f} px (rows, columns)"],
        ["order", plan.order],
        ["source positions", f"{forecast.positions}"],
        ["frames", f"{forecast.frames} ({plan.frames_averaged} per position)"],
        ["total time", format_seconds(forecast.hours * 3600) + unread],
        ["  exposing", format_seconds(forecast.exposure_hours * 3600)],
        *([] if readout is None else [["  reading out", _readout(forecast.frames, readout)]]),
        ["  settling", f"{format_seconds(forecast.settle_hours * 3600)} ({format_seconds(plan.settle_s)} per move)"],
        ["  moving", f"{format_seconds(forecast.move_hours * 3600)} at {format_length(task.speed)}/s"],
        ["whole frames on disk", format_bytes(forecast.frame_bytes) + _rests(plan, WHOLE_FRAMES)],
        ["cutouts on disk (uint16)", format_bytes(forecast.cutout_bytes)],
        ["H, float32", f"{format_bytes(forecast.h_float32_bytes)} before compression"],
        ["H, rounded", f"{format_bytes(forecast.h_rounded_bytes)} at most"],
        ["HT, if exported (float32)", format_bytes(forecast.ht_float32_bytes)],
        ["memory to assemble (two planes)", format_bytes(forecast.assembly_bytes)],
        *_noise(one.facts.get("noise")),
        *([["half-cell scan", _other_half(ny // 2, nx // 2)]] if half else []),
    ]


def _array(plan: ScanPlan) -> list[list[str]]:
    """Return the table rows on the lenslets and their period."""
    camera, (_, ny, nx, *_) = plan.camera, plan.shape
    count = ["positions per plane (x × y)", f"{nx} × {ny} = {nx * ny}"]
    if not camera.has_lattice:
        lenslets = len(camera.lattice.lenslets_within(math.inf, math.inf)[0])
        return [["camera", f"{camera.name}: {lenslets} lenslets in a pupil plane, no lattice"], count]
    (py, px), (ry, rx) = camera.period_px, plan.period_residual_px
    return [
        ["camera", f"{camera.name}: {camera.lattice.kind}, {len(camera.lattice.types)} lens type(s)"],
        ["cell of the lenslet array (x × y)", f"{px:.3f} × {py:.3f} px"],
        count,
        ["residual over one period (x, y)", f"{rx:+.3f}, {ry:+.3f} px{_cure(plan)}"],
        ["tilt over one period", f"{plan.tilt_residual_px:+.3f} px"],
    ]


def _from(plan: ScanPlan) -> str:
    return "  from the nearest type-0 lenslet" if plan.camera.has_lattice else "  from the optical axis"


def _noise(planes: tuple[float, ...] | None) -> list[list[str]]:
    if planes is None:
        return []
    whole = math.sqrt(sum(share**2 for share in planes) / len(planes))
    return [["expected noise of H (rms)", f"{format_share(whole)}, worst plane {format_share(max(planes))}"]]


def _readout(frames: int, hours: float) -> str:
    return f"{format_seconds(hours * 3600)} at {frames / hours / 3600:.4g} frames/s"


def _other_half(down: int, along: int) -> str:
    return f"rows 0 to {down - 1}; the other positions have the same patterns, {down}, {along} px away"


def _cure(plan: ScanPlan) -> str:
    if plan.resample:
        fy, fx = plan.resample_factors
        return f", removed: frames are resampled × {fx:.6f}, {fy:.6f}"
    worst = max(map(abs, plan.period_residual_px))
    return " (--resample removes it)" if worst > 0.005 else ""


def _span(values: list[str]) -> str:
    return values[0] if len(values) == 1 else f"{values[0]} … {values[-1]}"
