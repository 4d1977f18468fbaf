"""The table and the chart of ``python -m benchmarks solvers``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks._solver_scenes import BACKGROUND, BESIDE, COARSE, FINE, PEAK
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
    headers = ["scene", "solver", *(f"{n}" for n in UNITS), "iterations", "least", "auto: NRMSE", "s", "bead width"]
    rows = []
    for one in trials:
        cells = [_shown(one.at(n)) for n in UNITS]
        width = "" if one.width is None else f"{one.width:.2f}"
        stop = [f"{one.stop[1]:.3f}", f"{one.stop[0]:.2f}"]
        rows.append([one.scene, one.solver, *cells, f"{len(one.errors)}", _shown(min(one.errors)), *stop, width])
    return headers, rows


def verdict(trials: Sequence[Trial]) -> list[str]:
    """Return how often the default is the best, or within 3 % of it, at each time, camera by camera."""
    ours = SolverChoice()
    lines = [
        f"{ours.name} wins or ties after {units} iterations of rl: {_won(trials, ours.name, units)}" for units in UNITS
    ]
    own = f"{ours.name} wins or ties after its own {ours.iterations} iterations"
    return [*lines, f"{own}: {_won(trials, ours.name, None, ours.iterations)}"]


def _won(trials: Sequence[Trial], ours: str, units: float | None, iterations: int = 1) -> str:
    """Return the scenes of each camera where ``ours`` is best at a time; None: that of so many iterations of its."""
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
    """Return the page of the table that ``command`` made, with the picture ``chart`` where there is one."""
    times = ", ".join(f"{n}" for n in UNITS)
    parts = [
        "# Solvers compared",
        "",
        f"Made by `{command}`; not to be edited.",
        f"Numbers are the NRMSE of the volume after as much processor time as {times} iterations of",
        "Richardson-Lucy take with that camera; `auto` is where a run that stops by left-out pixels ends, and after",
        "how many processor seconds. Bead width is the full width at half maximum of the beads at the end, over that",
        f"of the truth. What is within {100 * (TIE - 1):.0f} % of the best counts as a tie.",
        "",
        f"Noise is that of photons, {PEAK:g} in the brightest pixel over a background of {BACKGROUND:g}. The light",
        f"lies in twice as many planes as are sought, none of them one of these, and {BESIDE:g} pixels off the",
        f"voxels; the frame is made with H simulated for those places to within {100 * FINE:g} %, while H that is",
        f"inverted is simulated to within {100 * COARSE:g} %. `bench` and `r29-like` have no plane near the native",
        "one.",
        "",
        *(f"- {line}" for line in verdict(trials)),
    ]
    if chart:
        parts += ["", f"![Error of each solver against processor time]({chart})", "", "Dots: where `auto` ends."]
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
    """Draw error against processor seconds: a panel per camera and scene, dots where runs stop by themselves."""
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
