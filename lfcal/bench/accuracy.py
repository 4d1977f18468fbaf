"""``lfcal bench accuracy``: seconds and error of every level of the simulator, against its reference."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.cli.console import print_json, print_table, run_work
from lfcal.cli.options import CameraArgument, ForceOption, JsonOption
from lfcal.units import format_seconds

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.simulate.accuracy.ladder import Ladder

__all__ = ["register"]


def register(bench: typer.Typer) -> None:
    """Add ``accuracy`` to the benchmarks."""
    bench.command("accuracy")(command)


def command(
    camera: CameraArgument = "bench",
    *,
    virtual_depth: float = typer.Option(4.0, help="Plane, as virtual depth (main lens)."),
    depth: float | None = typer.Option(None, help="Plane in µm away from the camera, instead."),
    tolerance: float = typer.Option(0.03, help="Relative L1 error for which a level is picked."),
    positions: int = typer.Option(3, min=1, help="Positions compared with the reference."),
    figure: Path | None = typer.Option(None, "-o", "--out", help="Draw the curve into this PNG."),
    check: bool = typer.Option(
        False, "--check", help="Also simulate the whole H and compare its time with the forecast."
    ),
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Measure what each step of accuracy costs for one plane of a camera.

    Example: `lfcal bench accuracy r29 --virtual-depth 4 -o r29.png`
    """
    from lfcal.camera import ScanPlan
    from lfcal.cli.outputs import check_output
    from lfcal.cli.plan import load_camera
    from lfcal.simulate.accuracy.ladder import draw_ladder, iter_ladder

    if figure is not None:
        check_output(figure, camera, force=force)
    described = load_camera(camera)
    planes = {"depths_um": [depth]} if depth is not None else {"virtual_depths": [virtual_depth]}
    plan = ScanPlan.for_camera(described, **planes)  # type: ignore[arg-type]
    found = run_work(iter_ladder(described, plan, tolerance, positions=positions), quiet=json)
    title = f"{described.name}, {plan.period[1]} x {plan.period[0]} positions"
    if figure is not None:
        draw_ladder(found, figure, f"{title}, {plan.cutout[0]} x {plan.cutout[1]} px, v = {found.virtual_depth:.3g}")
    timing = _timed(plan, tolerance) if check else None
    if json:
        picked = found.chosen.label if found.chosen else None
        print_json({"ladder": found, "picked": picked, "check": timing, "plan": plan.to_dict()})
        return
    _show(found, f"{title}, v = {found.virtual_depth:.3g}")
    if timing is not None:
        typer.echo(
            f"whole H: predicted {timing['predicted']:.3g} s, took {timing['measured']:.3g} s of processor "
            f"time ({timing['ratio']:.2f} times)"
        )
    if figure is not None:
        typer.echo(f"written: {figure}")


def _show(found: Ladder, title: str) -> None:
    rows = [
        [
            r.label,
            f"{100 * r.error:.2g} %",
            format_seconds(r.setup_seconds),
            format_seconds(r.position_seconds),
            format_seconds(r.whole_seconds),
            ("efficient" if r.efficient else "") + (", picked" if r is found.chosen else ""),
        ]
        for r in found.rungs
    ]
    rows.append([found.reference, "—", "", "", format_seconds(found.reference_seconds), "reference"])
    headers = ["level", "L1 error", "tables", "per position", "whole H", ""]
    print_table(headers, rows, title=f"{title}; processor time, error over {found.positions} positions")
    for label in found.refused:
        typer.echo(f"too coarse for this plane (energy does not balance): {label}")


def _timed(plan: ScanPlan, tolerance: float) -> dict[str, float]:
    """Return the seconds predicted and measured for the whole H in memory."""
    from lfcal.simulate import predict_seconds, simulate_psf

    predicted = predict_seconds(plan, tolerance=tolerance)
    # Processor time: what else runs on the machine does not count, and the forecast is in the same unit.
    start = time.process_time()
    simulate_psf(plan.camera, plan, tolerance=tolerance)
    measured = time.process_time() - start
    return {"predicted": predicted, "measured": measured, "ratio": predicted / measured}
