"""``lfcal assemble``: frames to H."""

from __future__ import annotations

import math
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError
from lfcal.cli._channels import ChannelPart, open_colour, parts_of
from lfcal.cli._completing import complete_orientation
from lfcal.cli._listed import ColumnsOption, OriginOption, report_notes, tell_size
from lfcal.cli._options import (
    CompressionOption,
    ExecutorOption,
    ForceOption,
    JsonOption,
    ResumeOption,
    SchedulerOption,
    StoreToleranceOption,
    WorkersOption,
)
from lfcal.cli._regions import make_regions
from lfcal.cli._runs import may_replace, run_choice, run_kept
from lfcal.cli._scan_frames import ScanFrames
from lfcal.cli._usage import refuse

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.frames import CorrectionRecipe
    from lfcal.psf import AssemblyReport, AssemblySettings
    from lfcal.work import RunChoice


RATE = 100e6
"""Bytes of frames that are read, corrected and cropped in a second of processor time, about."""

LISTED = 20
"""Damaged frames that are listed; all of them are in the JSON output and in the file's provenance."""


def register(app: typer.Typer) -> None:
    """Add ``assemble`` to the app."""
    app.command("assemble")(command)


def command(
    context: typer.Context,
    frames: Path = typer.Argument(
        help="Folder of frames, manifest (.csv, .json), one file of many frames, a recorded session, or a scan plan "
        "(.json), which the simulated camera then records."
    ),
    *,
    out: Path = typer.Option(..., "--out", "-o", help="H file to write (.h5)."),
    plan: Path | None = typer.Option(
        None, "--plan", "-p", help="Scan plan (.json); the session's own, or plan.json beside the frames, by default."
    ),
    manifest: Path | None = typer.Option(
        None, "--manifest", help="Manifest or list of the frames (.csv, .tsv, .txt, .json), if not with them."
    ),
    columns: ColumnsOption = "",
    first: int | None = typer.Option(
        None, "--first", min=0, max=1, help="Number of the first position in names or lists; found by default."
    ),
    pattern: str = typer.Option("", "--pattern", help="Positions from file names, e.g. 'z{z}_y{y}_x{x}.png'."),
    order: str = typer.Option("", "--order", help="Positions from the order of names: serpentine or raster."),
    dark: str = typer.Option(
        "", "--dark", help="Dark frame, or a folder of them to average; none: not even those recorded with the frames."
    ),
    black_level: float | None = typer.Option(
        None,
        "--black-level",
        help="Sample value of no light (after --shift), where there is no dark frame; 0 says there is none.",
    ),
    white: Path | None = typer.Option(None, "--white", help="White image, or a folder of them to average."),
    white_mode: str = typer.Option(
        "field", "--white-mode", help="field: the smooth fall of light, micro-images stay; pixels: pixel by pixel."
    ),
    white_floor: float = typer.Option(0.05, "--white-floor", help="Lowest relative brightness divided by."),
    defects: bool = typer.Option(False, "--defects", help="Find defect pixels over the frames and repair them."),
    background: str = typer.Option("none", "--background", help="none, border, plane, or a number of counts."),
    exposure: str = typer.Option(
        "auto", "--exposure", help="auto: scale frames of unequal known exposure to one; none; or seconds to scale to."
    ),
    saturation: float | None = typer.Option(None, "--saturation", help="Sample value of saturation (after --shift)."),
    shift: str = typer.Option("0", "--shift", help="Bits by which left-aligned samples are moved down, or auto."),
    channel: str = typer.Option(
        "",
        "--channel",
        help="Colour of a mosaic (R, G1, G2, B) or picture (R, G, B); each: an H file of every one.",
    ),
    orientation: str = typer.Option(
        "check",
        "--orientation",
        autocompletion=complete_orientation,
        help="What makes the frames upright: as-is, rot90, rot180, rot270 (anticlockwise), mirror-x (left to right), "
        "mirror-y, transpose, anti-transpose; auto: find it; check: as-is, but stop where it is certainly wrong.",
    ),
    origin: OriginOption = "",
    cutout: str = typer.Option("", "--cutout", help="Odd number of pixels, ROWS,COLUMNS, or 'auto' by energy."),
    lost: float = typer.Option(0.005, "--lost", help="With --cutout auto: largest share of energy left outside."),
    interpolation: str = typer.Option("", "--interpolation", help="nearest, linear, cubic or fourier."),
    half_cell: bool = typer.Option(
        False, "--half-cell", help="Of a half-cell scan: patterns half a period away stand for those not recorded."
    ),
    pad: bool = typer.Option(False, "--pad", help="Pad cutouts that leave the sensor with zeros, and mark them."),
    fill: Path | None = typer.Option(
        None, "--fill", help="Folder of lfcal fit of this scan: its model fills missing positions, which stay marked."
    ),
    strict: bool = typer.Option(False, "--strict", help="Missing and repeated positions are errors."),
    skip_damaged: bool = typer.Option(
        False, "--skip-damaged", help="Leave out frames that cannot be read, and list them; every frame is read twice."
    ),
    keep_pedestal: bool = typer.Option(
        False, "--keep-pedestal", help="Accept frames whose black level nothing subtracts."
    ),
    dtype: str = typer.Option("rounded", "--dtype", help="Stored type: rounded (16 bits for each plane), or float32."),
    compression: CompressionOption = "gzip",
    store_tolerance: StoreToleranceOption = None,
    workers: WorkersOption = None,
    executor: ExecutorOption = "",
    scheduler: SchedulerOption = "",
    resume: ResumeOption = False,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Correct and crop point-source frames with the shifting cutout, and assemble them into H.

    Of frames of a target (--plan a target's plan) its points are found, and those that show positions assembled.

    Example: `lfcal assemble session/frames --dark session/dark --white session/white -o H.h5`
    """
    from lfcal.campaign import is_regions
    from lfcal.cli._assemble_target import assemble_target
    from lfcal.cli._cameras import tell_assumed
    from lfcal.cli._console import print_json
    from lfcal.cli._orientation import check_choice
    from lfcal.cli._target_frames import refuse_options, wanted_target
    from lfcal.cli.outputs import check_output
    from lfcal.cli.plan import parse_cutout
    from lfcal.frames import CorrectionRecipe, chosen_shift, is_part_of_sensor, parse_origin
    from lfcal.psf import AssemblySettings

    check_choice(orientation)
    if lost != AssemblySettings.lost and cutout != "auto":
        raise InputError.expected("--lost", "--cutout auto", cutout or "the plan's cutout", "leave it out")
    if white is None:
        refuse(context, "--white", "none", "white_mode", "white_floor")
    place = parse_origin(origin)
    words = ScanFrames(frames, plan, manifest, pattern, order, columns, first, skip_damaged, orientation, place)
    # a manifest's frames are in its folder
    read = (frames, words.beside, plan, manifest, dark, white, fill)
    if channel != "each":
        check_output(out, *read, force=may_replace(out, resume=resume, force=force))
    recipe = CorrectionRecipe(
        dark=dark,
        black_level=black_level,
        white=white or "",
        white_mode=white_mode,
        white_floor=white_floor,
        defects=defects,
        background=background,
        exposure=exposure,
        saturation=saturation,
    )
    settings = AssemblySettings(
        cutout="auto" if cutout == "auto" else parse_cutout(cutout),
        lost=lost,
        interpolation=interpolation,
        pad=pad,
        strict=strict,
        keep_pedestal=keep_pedestal,
        dtype=dtype,
        compression=compression,
        workers=workers,
        store_tolerance=store_tolerance,
    )
    if is_regions(frames):
        one = {
            "--plan": plan is not None,
            "--manifest": manifest is not None,
            "--channel": channel == "each",
            "--fill": fill is not None,
            "--origin": place is not None,
            "--executor": bool(executor or scheduler or resume),
            "--store-tolerance": store_tolerance is not None,
            "--pattern": bool(pattern),
            "--order": bool(order),
            "--columns": bool(columns),
            "--first": first is not None,
        }
        how = _How(settings, orientation, half_cell, None, skip_damaged, True)
        several = _assemble_regions(words, out, replace(recipe, channel=channel), how, shift, one)
        if json:
            print_json(several)
        else:
            for name, facts in several["regions"].items():
                typer.echo(f"{name}: H {facts['shape']} from {facts['frames']} frames, {len(facts['missing'])} missing")
            typer.echo(f"{out}: H of {len(several['regions'])} regions")
        return
    target = wanted_target(frames, plan)
    if target is not None:
        refuse_options(
            {
                "--channel": channel,
                "--half-cell": half_cell,
                "--fill": fill,
                "--origin": origin,
                "--pattern": pattern,
                "--order": order,
                "--manifest": manifest,
                "--columns": columns,
                "--first": first is not None,
                "--shift": shift != "0",
                "--orientation": orientation not in ("check", "as-is"),
                "--executor": executor or scheduler or resume,
            }
        )
        made = assemble_target(
            frames, target, recipe, settings, out, skip_damaged=skip_damaged, json=json, show=show_report
        )
        if json:
            print_json(made)
        return
    with ExitStack() as stack:
        source, scan = open_colour(words.open, channel)
        stack.enter_context(source)
        tell_assumed(scan.camera, "plan", quiet=json)
        # a session knows which part of the sensor it recorded; of other frames the place has to be stated
        placed = source.metadata.plan is not None or place is not None or is_part_of_sensor(source.shape, scan.camera)
        if not placed:
            tell_size(source.shape, scan.camera, folder=str(frames), channel=channel)
        report_notes(source.metadata.notes)
        bits, note = chosen_shift(shift, source)
        report_notes([note] if note else [])
        parts = parts_of(channel, source, scan, out, lambda name: stack.enter_context(words.open(name)[0]))
        if channel == "each":
            for part in parts:
                again = may_replace(part.out, resume=resume, force=force)
                check_output(part.out, *read, force=again)
        ahead = len(source) * math.prod(source.shape) * source.dtype.itemsize / RATE
        runs = [
            run_choice(part.out, executor, scheduler, workers, resume=resume, force=force, seconds=ahead)
            for part in parts
        ]
        found = []
        for part, run in zip(parts, runs, strict=True):
            own = replace(recipe, shift=bits, channel=part.channel)
            how = _How(settings, orientation, half_cell, fill, skip_damaged, json)
            found.append(_assemble(part, scan, own, how, words, run))
    if json:
        print_json(found if channel == "each" else found[0])


@dataclass(frozen=True)
class _How:
    """How frames become H beside their corrections, by the options' words."""

    settings: AssemblySettings
    orientation: str
    half_cell: bool
    fill: Path | None
    skip_damaged: bool
    json: bool


def _assemble(
    part: ChannelPart, scan: ScanPlan, recipe: CorrectionRecipe, how: _How, words: ScanFrames, run: RunChoice | None
) -> dict[str, Any]:
    """Correct, crop and write H; print what was made, or return it for ``json``."""
    from lfcal.cli._console import run_work
    from lfcal.cli._orientation import upright
    from lfcal.cli._part_frames import PartFrames
    from lfcal.frames import check_turned_colours, corrected_view, iter_undamaged, with_partners
    from lfcal.psf import iter_assemble_plan

    start, settings, json = time.perf_counter(), how.settings, how.json
    frames = part.source
    known: dict[str, Any] = {"intake": list(frames.metadata.notes)} if frames.metadata.notes else {}
    left_out: tuple[int, ...] = ()
    if how.skip_damaged:
        frames = run_work(iter_undamaged(frames, workers=settings.workers), quiet=json)
        left_out = tuple(sorted(set(range(len(part.source))) - set(frames.chosen.tolist())))
    view, lie = upright(corrected_view(frames, recipe, scan), part.plan, how.orientation, quiet=json)
    turn = str(lie["orientation"]["applied"])
    check_turned_colours(frames, scan, recipe, turn)
    if how.half_cell:
        view = with_partners(view, part.plan)
    filler = None
    if how.fill is not None:
        from lfcal.fit import Filler, read_fit

        filler = Filler(read_fit(how.fill), part.plan, settings.workers)
        known |= {"filled": filler.provenance}
    more: dict[str, Any] = {"provenance": known | lie, "fill": filler}
    if run is None:
        report = run_work(iter_assemble_plan(view, part.plan, part.out, settings, **more), quiet=json)
    else:
        same = PartFrames(words, part.name, recipe, turn, how.half_cell, left_out, how.fill)
        more |= {"run": run, "reopening": same.reopening(part.source)}
        report = run_kept(iter_assemble_plan(view, part.plan, part.out, settings, **more), part.out, quiet=json)
    with report.matrix:
        return show_report(report, part.out, time.perf_counter() - start, json)


def _assemble_regions(
    words: ScanFrames, out: Path, recipe: CorrectionRecipe, how: _How, shift: str, given: dict[str, bool]
) -> dict[str, Any]:
    """Make H of every region of a session into one file; options ``given`` are of one region alone."""
    from lfcal.campaign import read_regions
    from lfcal.frames import chosen_shift

    settings = how.settings

    def region(_: ScanPlan, name: str, part: Path) -> dict[str, Any]:
        own = replace(words, frames=words.frames / name)
        source, scan = open_colour(own.open, recipe.channel)
        with source:
            corrected = replace(recipe, shift=chosen_shift(shift, source)[0])
            return _assemble(ChannelPart(source, scan, recipe.channel, part), scan, corrected, how, own, None)

    saving = {"dtype": settings.dtype, "compression": settings.compression, "workers": settings.workers}
    return make_regions(read_regions(words.frames), out, region, given, **saving)


def show_report(report: AssemblyReport, out: Path, seconds: float, json: bool) -> dict[str, Any]:
    """Return what was assembled, and print it but for ``json``; what nobody measured is null or "unknown"."""
    from lfcal.base import format_bytes, format_seconds
    from lfcal.cli._console import report as line
    from lfcal.cli._findings import show_judgement
    from lfcal.judge import judgement_of

    matrix, judgement = report.matrix, judgement_of(report)
    facts = {
        "out": out,
        "shape": matrix.shape,
        "frames": report.frames,
        "missing": report.missing,
        "filled": report.filled,
        "repeated": report.repeated,
        "orientation": matrix.provenance.get("orientation", {"applied": report.orientation}),
        "left_out": [found._asdict() for found in report.left_out],
        "half_cell": matrix.provenance.get("half_cell"),
        "saturated_positions": report.saturated,
        "unknown_saturation": report.unknown_saturation,
        "spread": report.spread,
        "padded": report.padded,
        "residual_px": report.residual_px,
        "assumed": [] if matrix.camera is None else matrix.camera.marks.paths("assumed"),
        "file_bytes": out.stat().st_size,
        "seconds": seconds,
    } | judgement.to_dict()
    if json:
        return facts
    told = matrix.provenance.get("orientation", {}).get("note")
    copied = matrix.provenance.get("half_cell", {}).get("filled", 0)
    if copied:
        line(f"note: {copied} positions have the patterns recorded half a period away; they are marked")
    for note in (*([told] if told else []), *report.notes):
        line(f"note: {note}")
    if report.filled:
        line(f"note: {report.filled} of the missing positions are filled by the model of the fit, and marked")
    for found in report.left_out[:LISTED]:
        where = "dark frame" if found.position is None else f"(z, y, x) = {tuple(found.position)}"
        line(f"left out: {found.label}, {where}")
    size = format_bytes(out.stat().st_size)
    # what the cutout, by whole pixels, leaves of the fractional shifts of the micro-images.
    rows, columns = report.residual_px
    typer.echo(f"{out}: H {matrix.shape} from {report.frames} frames, {size} in {format_seconds(seconds)}")
    show_judgement(judgement)
    typer.echo(f"sub-pixel residual left by the cutout: {rows:.2f} rows, {columns:.2f} columns (px)")
    return facts
