"""``lfcal assemble``: frames to H."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.frames import FrameSource
    from lfcal.psf.assemble import AssemblyReport


def register(app: typer.Typer) -> None:
    """Add ``assemble`` to the app."""
    app.command("assemble")(command)


def command(
    frames: Path = typer.Argument(
        help="Folder of frames, manifest (.csv, .json), one file of many frames, or a recorded session."
    ),
    out: Path = typer.Option(..., "--out", "-o", help="H file to write (.h5)."),
    plan: Path = typer.Option(None, "--plan", "-p", help="Scan plan (.json); plan.json beside the frames by default."),
    manifest: Path = typer.Option(None, "--manifest", help="Manifest of the frames, if it does not lie with them."),
    pattern: str = typer.Option("", "--pattern", help="Positions from file names, e.g. 'z{z}_y{y}_x{x}.png'."),
    order: str = typer.Option("", "--order", help="Positions from the order of names: serpentine or raster."),
    dark: Path = typer.Option(None, "--dark", help="Dark frame, or a folder of them to average."),
    white: Path = typer.Option(None, "--white", help="White frame, or a folder of them to average."),
    white_mode: str = typer.Option(
        "field", "--white-mode", help="field: the smooth fall of light, micro-images stay; pixels: pixel by pixel."
    ),
    white_floor: float = typer.Option(0.05, "--white-floor", help="Lowest relative brightness divided by."),
    defects: bool = typer.Option(False, "--defects", help="Find defect pixels over the frames and repair them."),
    background: str = typer.Option("none", "--background", help="none, border, plane, or a number of counts."),
    reference: float = typer.Option(None, "--reference-exposure", help="Scale frames to this exposure (s)."),
    saturation: float = typer.Option(None, "--saturation", help="Sample value of saturation."),
    channel: str = typer.Option("", "--channel", help="Colour channel of a mosaic: R, G1, G2, B …"),
    cutout: str = typer.Option("", "--cutout", help="Odd number of pixels, ROWS,COLUMNS, or 'auto' by energy."),
    lost: float = typer.Option(0.005, "--lost", help="With --cutout auto: largest share of energy left outside."),
    interpolation: str = typer.Option("", "--interpolation", help="nearest, linear, cubic or fourier."),
    pad: bool = typer.Option(False, "--pad", help="Pad cutouts that leave the sensor with zeros, and mark them."),
    strict: bool = typer.Option(False, "--strict", help="Missing and duplicate positions are errors."),
    dtype: str = typer.Option("float32", "--dtype", help="Stored type: float32, or uint16 with a scale per plane."),
    compression: str = typer.Option("gzip", "--compression", help="gzip, zstd or none."),
    workers: int = typer.Option(None, "--workers", help="Threads; every processor by default."),
    json: bool = typer.Option(False, "--json", help="Print the result as JSON."),
) -> None:
    """Correct and crop point-source frames with the shifting cutout, and assemble them into H.

    Example: `lfcal assemble session/frames --dark session/dark --white session/white -o H.h5`
    """
    import time
    from contextlib import ExitStack
    from dataclasses import replace

    from lfcal.cli.console import run_work
    from lfcal.frames import channel_source, open_frames
    from lfcal.frames.corrections.recipe import CorrectionRecipe, build_chain
    from lfcal.psf.assemble import iter_assemble
    from lfcal.psf.cutout import Cutout

    start = time.perf_counter()
    if (frames / "session.json").is_file():
        _assemble_recording(
            frames,
            out,
            start,
            json,
            interpolation=interpolation,
            dtype=dtype,
            compression=compression,
            strict=strict,
            workers=workers,
        )
        return
    scan = read_plan(frames, plan)
    with ExitStack() as stack:
        source: Any = stack.enter_context(
            open_frames(
                frames, manifest=manifest, pattern=pattern or None, order=order or None, plan_shape=scan.shape[:3]
            )
        )
        if channel:
            source = channel_source(source, channel)
        recipe = CorrectionRecipe(
            dark or "", white or "", white_mode, white_floor, defects, background, reference, saturation
        )
        chain = build_chain(source, recipe)
        window = Cutout.for_plan(scan, interpolation=interpolation, outside="zero" if pad else "error")
        if cutout:
            window = replace(window, shape=_cutout_shape(cutout, source, chain, window, lost))
        work = iter_assemble(
            source,
            scan.shape[:3],
            window,
            out,
            corrections=chain,
            depths=scan.depths_um,
            camera=scan.camera,
            strict=strict,
            dtype=dtype,
            compression=compression,
            workers=workers,
            provenance={"plan": scan.to_dict()},
        )
        report = run_work(work, quiet=json)
    with report.matrix:
        _show(report, out, time.perf_counter() - start, json)


def _assemble_recording(folder: Path, out: Path, start: float, json: bool, **options: Any) -> None:
    """Assemble the session of ``lfcal acquire``: it brings its plan, cutouts and dark frames itself."""
    import time

    from lfcal.acquire.finish import iter_assemble_session
    from lfcal.cli.console import run_work

    report = run_work(iter_assemble_session(folder, out, **options), quiet=json)
    with report.matrix:
        _show(report, out, time.perf_counter() - start, json)


def read_plan(frames: Path, plan: Path | None) -> ScanPlan:
    """Return the plan of a file, or of ``plan.json`` in or above the folder of the frames."""
    from lfcal.camera import ScanPlan
    from lfcal.errors import InputError
    from lfcal.files import storage_errors

    folder = frames if frames.is_dir() else frames.parent
    found = [plan] if plan else [p for p in (folder / "plan.json", folder.parent / "plan.json") if p.is_file()]
    if not found or found[0] is None:
        raise InputError.expected(
            "scan plan", f"plan.json in {folder} or above", "none", "make one with lfcal plan, or name it"
        )
    with storage_errors(found[0]):
        return ScanPlan.from_json(found[0].read_text(encoding="utf-8", errors="replace"))


def _cutout_shape(text: str, source: FrameSource, chain: Any, window: Any, lost: float) -> tuple[int, int]:
    from lfcal.errors import InputError
    from lfcal.psf.cutout import find_cutout

    if text == "auto":
        sample = range(0, len(source), max(1, len(source) // 24))
        images = (chain.apply(source.read(k)) for k in sample)
        anchor = window.anchor
        centres = ((anchor[0] + source.position(k).y, anchor[1] + source.position(k).x) for k in sample)
        return find_cutout(images, centres, lost=lost)
    try:
        sizes = [int(part) for part in text.split(",")]
    except ValueError:
        sizes = []
    if len(sizes) not in (1, 2):
        raise InputError.expected("--cutout", "an odd number, ROWS,COLUMNS or auto", text, "correct it")
    return (sizes[0], sizes[-1])


def _show(report: AssemblyReport, out: Path, seconds: float, json: bool) -> None:
    from lfcal.cli.console import print_json
    from lfcal.cli.console import report as line
    from lfcal.units import format_bytes, format_seconds

    matrix = report.matrix
    if json:
        print_json(
            {
                "out": out,
                "shape": matrix.shape,
                "frames": report.frames,
                "missing": report.missing,
                "duplicates": report.duplicates,
                "saturated_frames": report.saturated,
                "padded": report.padded,
                "residual_px": report.residual_px,
                "file_bytes": out.stat().st_size,
                "seconds": seconds,
            }
        )
        return
    for note in report.notes:
        line(f"note: {note}")
    size = format_bytes(out.stat().st_size)
    rows, columns = report.residual_px
    typer.echo(f"{out}: H {matrix.shape} from {report.frames} frames, {size} in {format_seconds(seconds)}")
    typer.echo(f"sub-pixel rest left by the cutout: {rows:.2f} rows, {columns:.2f} columns (px)")
