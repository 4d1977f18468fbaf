"""The table and the chart of ``python -m benchmarks solvers``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks._solver_scenes import BACKGROUND, COARSE, FINE, OFF_GRID, PEAK
from benchmarks._solver_trials import TIE, UNITS, Trial
from lfcal.base.figures import LINES, figure, save_figure
from lfcal.reconstruct.solvers.choice import SolverChoice

__all__ = ["draw", "markdown", "rows_of", "verdict"]


def _pairs(trials: Sequence[Trial]) -> list[tuple[str, str]]:
    return list(dict.fromkeys((one.camera, one.scene) for one in trials))


def _shown(error: float | None) -> str:
    return "—" if error is None else f"{error:.3f}"


def rows_of(trials: Sequence[Trial]) -> tuple[list[str], list[list[str]]]:
    """Return headers and cells: a row for each scene and solver."""
    headers = ["scene", "solver", *(f"{n}" for n in UNITS), "iterations", "smallest", "auto: NRMSE", "s", "bead width"]
    rows = []
    for one in trials:
        cells = [_shown(one.at(n)) for n in UNITS]
        width = "" if one.width is None else f"{one.width:.2f}"
        stop = [f"{one.stop[1]:.3f}", f"{one.stop[0]:.2f}"]
        rows.append([one.scene, one.solver, *cells, f"{len(one.errors)}", _shown(min(one.errors)), *stop, width])
    return headers, rows


def verdict(trials: Sequence[Trial]) -> list[str]:
    """Return, for each time and camera, the scenes in which the default solver is the best or within 3 % of it."""
    ours = SolverChoice()
    lines = [
        f"{ours.name} wins or ties after {units} iterations of rl: {_won(trials, ours.name, units)}" for units in UNITS
    ]
    own = f"{ours.name} wins or ties after its own {ours.iterations} iterations"
    return [*lines, f"{own}: {_won(trials, ours.name, None, ours.iterations)}"]


def _won(trials: Sequence[Trial], ours: str, units: float | None, iterations: int = 1) -> str:
    """Return the scenes of each camera in which ``ours`` wins or ties after a time; None: its own ``iterations``."""
    won: dict[str, list[str]] = {}
    for camera, scene in _pairs(trials):
        there = {one.solver: one for one in trials if (one.camera, one.scene) == (camera, scene)}
        won.setdefault(camera, [])
        if ours not in there:
            continue
        own = there[ours]
        time = own.seconds[min(iterations, len(own.seconds)) - 1] / own.unit_s if units is None else units
        found = {name: error for name, one in there.items() if (error := one.at(time)) is not None}
        if ours in found and found[ours] <= TIE * min(found.values()):
            won[camera].append(scene)
    return ", ".join(f"{camera} {' and '.join(scenes) or 'nothing'}" for camera, scenes in won.items())


def markdown(trials: Sequence[Trial], command: str, chart: str = "") -> str:
    """Return a page with the table that ``command`` made, and with the picture ``chart`` unless it is empty."""
    times = ", ".join(f"{n}" for n in UNITS)
    parts = [
        "# Solvers compared",
        "",
        f"Made by `{command}`; do not edit this page.",
        f"The numbers are the NRMSE of the volume after the processor time that {times} iterations of",
        "Richardson-Lucy take with this camera. `auto` lists the NRMSE and the processor time of a run that stops with",
        "held-out pixels. Bead width is the full width at half maximum of the beads at the end, divided by the true",
        f"width. Errors within {100 * (TIE - 1):.0f} % of the smallest one count as a tie.",
        "",
        f"The noise is photon noise: {PEAK:g} photons in the brightest pixel over a background of {BACKGROUND:g}. The",
        "light comes from twice as many planes as are reconstructed, all of them different, and from voxels",
        f"displaced by {OFF_GRID:g} pixels. H for these positions is simulated with a tolerance of {100 * FINE:g} %,",
        f"and H for the reconstruction with {100 * COARSE:g} %. `bench` and `r29-like` have no plane near the native",
        "plane.",
        "",
        *(f"- {line}" for line in verdict(trials)),
    ]
    if chart:
        parts += ["", f"![Error of each solver against processor time]({chart})", "", "Dots mark where `auto` stops."]
    for name in dict.fromkeys(one.camera for one in trials):
        own = [one for one in trials if one.camera == name]
        headers, rows = rows_of(own)
        parts += [
            "",
            f"## {name}",
            "",
            f"An iteration of Richardson-Lucy: {own[0].unit_s:.3f} s of processor time.",
            "",
        ]
        parts += [f"| {' | '.join(cells)} |" for cells in (headers, ["---"] * len(headers), *rows)]
    return "\n".join(parts) + "\n"


def draw(path: Path, trials: Sequence[Trial]) -> None:
    """Draw error against processor time, one panel per camera and scene; dots mark automatic stops."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    ours = SolverChoice().name
    pairs = _pairs(trials)
    cameras = list(dict.fromkeys(camera for camera, _ in pairs))
    across = max(sum(camera == own for own, _ in pairs) for camera in cameras)
    kinds = list(dict.fromkeys(one.solver for one in trials))
    with figure(3.6 * across + 1.6, 2.8 * len(cameras), dpi=90) as fig:
        panels = fig.subplots(len(cameras), across, squeeze=False)
        for k, (camera, scene) in enumerate(pairs):
            panel = panels[k // across][k % across]
            for one in trials:
                if (one.camera, one.scene) == (camera, scene):
                    n = kinds.index(one.solver)
                    colour, style = LINES[n % len(LINES)], ("-", "--", ":")[n // len(LINES) % 3]
                    width = 3.0 if one.solver == ours else 1.2
                    panel.plot(one.seconds, one.errors, style, color=colour, label=one.solver, linewidth=width)
                    panel.plot(*one.stop, "o", color=colour, markersize=4)
            panel.set_xscale("log")
            panel.set_yscale("log")
            for axis, steps in ((panel.xaxis, (1, 2, 5)), (panel.yaxis, range(1, 10))):
                axis.set_major_locator(LogLocator(subs=steps))
                axis.set_major_formatter(StrMethodFormatter("{x:g}"))
                axis.set_minor_formatter(NullFormatter())
            panel.set_title(f"{camera}: {scene}")
            if k // across == len(cameras) - 1:
                panel.set_xlabel("processor time (s)")
            if k % across == 0:
                panel.set_ylabel("NRMSE (1)")
        panels[0][-1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        save_figure(fig, path, colours=64)
