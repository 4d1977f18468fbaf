"""``lfcal plan``: what a scan will cost, and the plan as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray

from lfcal.base import InputError, format_bytes, format_length, format_seconds, replace_whole
from lfcal.camera import DEPTH, STEP, WHOLE_FRAMES, Forecast, ScanPlan, StageAxes, assumed_of
from lfcal.cli._console import print_json, print_table
from lfcal.cli._listed import ColumnsOption, OriginOption, plan_from_list
from lfcal.cli._options import (
    CameraArgument,
    CutoutOption,
    DepthsOption,
    ForceOption,
    JsonOption,
    VirtualDepthsOption,
    WorkersOption,
)
from lfcal.cli._plan_for_fit import (
    WantedPositions,
    check_wanted,
    half_positions,
    show_chosen,
    write_positions,
)
from lfcal.cli._plan_pace import WITHOUT_READOUT, FrameRateOption, Pace
from lfcal.cli._plan_regions import RegionsOption, plan_regions
from lfcal.cli._plan_target import (
    CrosstalkOption,
    MostFramesOption,
    PatternsOption,
    PhaseOption,
    PoseOption,
    SignalOption,
    SourceOption,
    TargetWanted,
    WithinOption,
    plan_source,
)
from lfcal.cli._usage import refuse
from lfcal.records import check_planes, read_as, read_cutout, read_depths, read_pair, read_virtual_depths
from lfcal.tasks import check_output, load_camera, ready_plan

__all__ = ["register"]


def _stage_axes(text: str) -> StageAxes:
    axes = [axis.strip() for axis in text.split(",")]
    if len(axes) != 3:
        raise InputError.expected("stage axes", "three, such as +x,-y,+z", repr(text), "correct them")
    return StageAxes(axes[0], axes[1], axes[2])


def _rests(plan: ScanPlan, paths: tuple[str, ...]) -> str:
    """Return what is to be said of a figure that rests on values at ``paths``: nothing, if none of them is assumed."""
    return " (from assumed values)" if assumed_of(plan.camera, paths) else ""


def _rows(plan: ScanPlan, forecast: Forecast, speed: float, computed: tuple[str, ...]) -> list[list[str]]:
    nz, ny, nx, nt, ns = plan.shape
    camera, (py, px), (ry, rx) = plan.camera, plan.camera.period_px, plan.period_residual_px
    steps = [plan.step_um(z)[1] for z in range(nz)]
    depths, virtual = plan.depths_um, plan.virtual_depths
    where = plan.lattice_anchor
    rests = {name: _rests(plan, DEPTH) if name in computed else "" for name in ("depths", "virtual depths")}
    rows = [
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
    return rows


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


def _as_json(plan: ScanPlan, forecast: Forecast) -> dict[str, object]:
    costs = {name: getattr(forecast, name) for name in forecast.__slots__}
    return {
        "period_px": plan.camera.period_px,
        "period": plan.period,
        "period_residual_px": plan.period_residual_px,
        "tilt_residual_px": plan.tilt_residual_px,
        "resample_factors": plan.resample_factors,
        "cutout": plan.cutout,
        "anchor_px": plan.anchor,
        "lattice_anchor_px": plan.lattice_anchor,
        "depths_um": plan.depths_um,
        "virtual_depths": plan.virtual_depths,
        "steps_um": [plan.step_um(z) for z in range(len(plan.depths_um))],
        "assumed": plan.camera.marks.paths("assumed"),
        "forecast": {
            **costs,
            "hours": forecast.hours,
            "bytes_per_s": forecast.bytes_per_s,
            "ht_float32_bytes": forecast.ht_float32_bytes,
        },
        "plan": plan.to_dict(),
    }


def register(app: typer.Typer) -> None:
    """Add ``plan`` to the app."""
    app.command("plan")(command)


def command(
    context: typer.Context,
    camera: CameraArgument,
    *,
    depths: DepthsOption = "",
    virtual_depths: VirtualDepthsOption = "",
    positions: Path | None = typer.Option(
        None, "--positions", help="List of stage coordinates of a scan that was recorded: its plan is made."
    ),
    frames: Path | None = typer.Option(None, "--frames", help="With --positions: the folder of the frames listed."),
    columns: ColumnsOption = "",
    origin: OriginOption = "",
    orientation: str = typer.Option(
        "as-is", "--orientation", help="With --positions: what makes the frames upright, as of lfcal assemble."
    ),
    cutout: CutoutOption = "",
    anchor: str = typer.Option("", help="Sensor ROW,COLUMN of the image at y = x = 0; by default centred."),
    resample: bool = typer.Option(False, "--resample", help="Scale the frames so that the period is whole."),
    order: str = typer.Option("serpentine", help="serpentine or raster."),
    stage: str = typer.Option("+x,+y,+z", help="Stage axes that move the image right, down, the source away."),
    exposure: float = typer.Option(0.02, help="Exposure (s)."),
    settle: float = typer.Option(0.05, help="Wait after each move (s)."),
    average: int = typer.Option(1, help="Frames per position."),
    speed: float = typer.Option(1000.0, help="Speed of the stage (µm/s)."),
    frame_rate: FrameRateOption = None,
    half_cell: bool = typer.Option(
        False, "--half-cell", help="Record half of a hexagonal period, where the other half is the same patterns."
    ),
    for_fit: int = typer.Option(
        0, "--for-fit", min=0, help="Choose so many positions that tell most of the optics; CAMERA may be a plan."
    ),
    chosen: Path | None = typer.Option(
        None,
        "--list",
        help="With --for-fit or --half-cell: write the positions (.json), for lfcal acquire --positions or --redo.",
    ),
    earlier: Path | None = typer.Option(None, "--from", help="With --for-fit: go on from this folder of lfcal fit."),
    unknowns: str = typer.Option(
        "", "--unknowns", help="With --for-fit: groups A,B,C; by default the fit's, or geometry,focal_lengths,iris."
    ),
    full: float = typer.Option(0.8, "--full", help="With --for-fit: full-well share of the brightest pixel."),
    beside: float | None = typer.Option(
        None, "--beside", help="With --for-fit: rms of sources beside their places (px); the fit's, or 0.05."
    ),
    candidates: int = typer.Option(300, "--candidates", min=0, help="With --for-fit: positions looked at; 0: all."),
    draw: Path | None = typer.Option(None, "--draw", help="With --for-fit: draw the expected error (.png)."),
    source: SourceOption = "",
    regions: RegionsOption = "",
    tolerance: PhaseOption = None,
    crosstalk: CrosstalkOption = None,
    pose: PoseOption = "",
    pose_within: WithinOption = "",
    most_frames: MostFramesOption = None,
    signal: SignalOption = None,
    patterns: PatternsOption = None,
    out: Path | None = typer.Option(None, "-o", "--out", help="Write the plan as JSON."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Plan a scan and show what it costs; or choose the few positions of it that a fit of the optics needs.

    Example: `lfcal plan r29 --virtual-depths 2:5.5:0.35 -o plan.json`
    """
    if not for_fit:
        refuse(context, "--for-fit", "none", "full", "candidates")
    pace = Pace(speed, frame_rate)
    wanted = WantedPositions(
        for_fit, half_cell, chosen, earlier, unknowns, full, beside, candidates, draw, pace, workers
    )
    check_wanted(wanted, out, camera, positions, force=force)
    aimed = TargetWanted(source, tolerance, crosstalk, pose, pose_within, most_frames, pace, signal, patterns)
    if regions and (for_fit or half_cell or positions is not None):
        other = "--for-fit" if for_fit else "--half-cell" if half_cell else "--positions"
        raise InputError(f"{other}: is of one region or of the whole frame; leave it out beside --regions")
    aimed.check(for_fit=bool(for_fit), half_cell=half_cell, listed=positions is not None, force=force)
    if out is not None:
        check_output(out, camera, positions, frames, aimed.path, force=force)
    if for_fit and (ready := ready_plan(camera)) is not None:
        if depths or virtual_depths or cutout or anchor or out is not None:
            raise InputError("planes, cutout, anchor and -o: expected those of the plan, got others; leave them out")
        of_a_camera = ("order", "stage", "exposure", "settle", "average", "resample")
        refuse(context, "a camera to plan for", f"the plan {camera}", *of_a_camera)
        show_chosen(ready, wanted, json=json)
        return
    lengths = read_as("--depths", read_depths, depths) or None
    virtual = read_as("--virtual-depths", read_virtual_depths, virtual_depths) or None
    settings: dict[str, Any] = {
        "cutout": read_as("--cutout", read_cutout, cutout),
        "anchor": read_as("--anchor", read_pair, anchor) if anchor else None,
        "order": order,
        "exposure_s": exposure,
        "settle_s": settle,
        "resample": resample,
    }
    axes = _stage_axes(stage)
    if positions is None and (frames is not None or columns or orientation != "as-is" or origin):
        names = "--frames, --columns, --orientation and --origin"
        raise InputError(f"{names}: are of a scan's list; name it with --positions LIST")
    if positions is not None:
        if average != 1:
            raise InputError("--average: a list itself says how often positions were recorded; leave it out")
        if lengths or virtual:
            check_planes(lengths, virtual)
        known = load_camera(camera)
        planes = lengths if virtual is None else tuple(known.depth_of(v) for v in virtual)
        plan = plan_from_list(
            positions,
            known,
            folder=frames,
            columns=columns,
            orientation=orientation,
            origin=origin,
            stage=axes,
            depths_um=planes,
            **settings,
        )
    else:
        check_planes(lengths, virtual)
        plan = ScanPlan.for_camera(
            load_camera(camera),
            depths_um=lengths,
            virtual_depths=virtual,
            stage=axes,
            frames_averaged=average,
            **settings,
        )
    if source:
        plan_source(plan, aimed, regions, out, json=json)
        return
    if regions:
        plan_regions(plan, regions, pace, out, json=json)
        return
    # of a list that states neither, both follow from the steps
    computed = [name for name, given in (("depths", lengths), ("virtual depths", virtual)) if given is None]
    if for_fit:
        _write(plan, pace, out)
        show_chosen(plan, wanted, json=json)
        return
    half = half_positions(plan) if half_cell else None
    _show(plan, pace, out, json, computed=tuple(computed), half=half)
    if half is not None and chosen is not None:
        write_positions(half, chosen, json=json)


def _write(plan: ScanPlan, pace: Pace, out: Path | None, positions: NDArray[np.intp] | None = None) -> Forecast:
    """Write the plan where asked, and return the forecast of its positions or of some of them."""
    # forecast before writing: a speed that makes no sense must leave no file behind.
    forecast = pace.forecast(plan, positions)
    if out is not None:
        with replace_whole(out) as part:
            part.write_text(plan.to_json(), encoding="utf-8")
    return forecast


def _show(
    plan: ScanPlan,
    pace: Pace,
    out: Path | None,
    json: bool,
    *,
    computed: tuple[str, ...],
    half: NDArray[np.intp] | None,
) -> None:
    """Write the plan where asked, and print it with its cost.

    ``computed`` are the planes that follow from others, ``half`` the positions of a half-cell scan.
    """
    forecast = _write(plan, pace, out, half)
    if json:
        print_json(_as_json(plan, forecast) | {"half_cell": half})
        return
    rows = _rows(plan, forecast, pace.stage_um_per_s, computed)
    if half is not None:
        ny, nx = plan.period
        rows.append(["half-cell scan", f"rows 0 to {ny // 2 - 1}; the rest is the same, {ny // 2}, {nx // 2} px away"])
    print_table(["scan plan", "value"], rows)
    if out is not None:
        typer.echo(f"written: {out}")
