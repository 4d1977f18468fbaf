"""``python -m benchmarks accuracy``: time and error of every level of the simulator, relative to its reference."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.base.checks import check_number
from lfcal.base.units import format_seconds
from lfcal.cli._console import print_json, print_table, run_work
from lfcal.cli._options import CameraArgument, ForceOption, JsonOption

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import ScanPlan
    from lfcal.simulate.accuracy._ladder import Ladder
    from lfcal.simulate.engines.base import PlaneEngine

__all__ = ["register"]

REPEATS = 3
"""Number of measurements of a time, of which the shortest counts."""


def register(bench: typer.Typer) -> None:
    """Add ``accuracy`` to the benchmarks."""
    bench.command("accuracy")(command)


def command(
    camera: CameraArgument = "bench",
    *,
    virtual_depth: float = typer.Option(4.0, help="Virtual depth of the plane (main lens)."),
    depth: float | None = typer.Option(
        None, help="Depth of the plane in µm, positive away from the camera, instead of its virtual depth."
    ),
    tolerance: float = typer.Option(0.03, help="Relative L1 error for which a level is chosen."),
    positions: int = typer.Option(3, min=1, help="Positions compared with the reference."),
    figure: Path | None = typer.Option(None, "-o", "--out", help="File for a plot of the curve (.png)."),
    asked: str = typer.Option("3,1,0.3", help="Tolerances (%) for which the true error is measured."),
    check: bool = typer.Option(
        False, "--check", help="Also simulate the whole H and compare its time with the forecast."
    ),
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Measure the processor time of each level of accuracy for one plane of a camera.

    Example: `python -m benchmarks accuracy r29 --virtual-depth 4 -o r29.png`
    """
    from lfcal.camera import ScanPlan
    from lfcal.records.reading import read_planes
    from lfcal.simulate.accuracy._ladder import draw_ladder, iter_ladder
    from lfcal.tasks import check_output
    from lfcal.tasks.cameras import load_camera

    wanted = read_planes(asked, lengths=False)
    for share in wanted:
        check_number("requested tolerance (%)", share, above=0, at_most=400)
    if figure is not None:
        check_output(figure, camera, force=force)
    described = load_camera(camera)
    planes = {"depths_um": [depth]} if depth is not None else {"virtual_depths": [virtual_depth]}
    plan = ScanPlan.for_camera(described, **planes)  # type: ignore[arg-type]
    found = run_work(iter_ladder(plan, tolerance, positions=positions), quiet=json)
    title = f"{described.name}, {plan.period[1]} x {plan.period[0]} positions"
    if figure is not None:
        draw_ladder(found, figure, f"{title}, {plan.cutout[0]} x {plan.cutout[1]} px, v = {found.virtual_depth:.3g}")
    timing = _timed(plan, tolerance) if check else None
    reached = [_reached(plan, share / 100, positions) for share in wanted]
    if json:
        picked = found.chosen.label if found.chosen else None
        print_json({"ladder": found, "picked": picked, "asked": reached, "check": timing, "plan": plan.to_dict()})
        return
    _show(found, f"{title}, v = {found.virtual_depth:.3g}")
    _show_reached(reached)
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
            ("efficient" if r.efficient else "") + (", chosen" if r is found.chosen else ""),
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
    # processor time, which other programs hardly affect, and which the forecast predicts
    start = time.process_time()
    simulate_psf(plan, tolerance=tolerance)
    measured = time.process_time() - start
    return {"predicted": predicted, "measured": measured, "ratio": predicted / measured}


@dataclass(frozen=True, slots=True)
class Reached:
    """Result of a tolerance, for the error of the computation alone.

    Attributes
    ----------
    asked
        Requested relative L1 error.
    level, label
        Chosen level and sampling.
    stated, true
        Error stated by the probe, and error relative to the finest reference at other positions.
    seconds
        Processor time of a position (s).
    reference_seconds
        Processor time of a position by the coherent reference, with the coarsest sampling of the same accuracy (s).
    """

    asked: float
    level: str
    label: str
    stated: float
    true: float
    seconds: float
    reference_seconds: float


def _reached(plan: ScanPlan, asked: float, positions: int) -> Reached:
    import numpy as np

    from lfcal.simulate import plan_effects
    from lfcal.simulate.accuracy._ladder import rung_label
    from lfcal.simulate.accuracy.forecast import plane_seconds
    from lfcal.simulate.accuracy.sampling import steps_for
    from lfcal.simulate.engines.choose import engine_for
    from lfcal.simulate.response import PlaneResponse

    effects = plan_effects(plan, asked).effects
    response = PlaneResponse(plan, 0, effects, tolerance=asked)
    engine = response.engine()
    ny, nx = plan.period
    places = [
        (ny * (2 * k + 1) // (2 * positions + 1), nx * (3 * k + 2) // (3 * positions + 1)) for k in range(positions)
    ]
    scene = response.scene
    if response.level == "debye":
        steps = steps_for(scene, "debye")
        enough = steps[6]
        truth = _rows(engine_for(scene, "debye", enough.sampling), places)
    else:
        steps = steps_for(scene, "reference")
        truth = _rows(engine_for(scene, "reference", steps[2].sampling), places)
        enough = next((step for step in steps if step.expected <= asked), steps[-1])
    each = _least(lambda: engine_for(scene, enough.level, enough.sampling).predicted_seconds(1))
    true = float(np.abs(_rows(engine, places) - truth).sum() / truth.sum())
    whole = _least(lambda: plane_seconds(engine_for(scene, response.level, response.settled)))
    label = rung_label(response.level, response.settled)
    return Reached(asked, response.level, label, response.reached, true, whole / (ny * nx), each)


def _least(seconds: Callable[[], float]) -> float:
    """Return the shortest of some measurements, because other load only lengthens them."""
    return min(seconds() for _ in range(REPEATS))


def _rows(engine: PlaneEngine, places: list[tuple[int, int]]) -> NDArray[np.float64]:
    """Return the responses of some positions."""
    import numpy as np

    return np.stack([engine.rows([y], [x], workers=1)[0, 0] for y, x in places]).astype(np.float64)


def _show_reached(found: Sequence[Reached]) -> None:
    rows = [
        [
            f"{100 * r.asked:g} %",
            r.label,
            f"{100 * r.stated:.2g} %",
            f"{100 * r.true:.2g} %",
            format_seconds(r.seconds),
            f"{r.seconds / found[0].seconds:.2g}",
            f"{r.reference_seconds / r.seconds:.3g}",
        ]
        for r in found
    ]
    headers = ["requested", "chosen", "stated", "true", "per position", "÷ first row", "reference ÷ this"]
    print_table(headers, rows, title="results of tolerances: error of the computation, with the effects of each")
