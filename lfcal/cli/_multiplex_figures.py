"""What ``lfcal multiplex`` draws and prints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import Clock, InputError, Work
from lfcal.cli._console import print_json, print_table, report
from lfcal.cli._multiplex_frames import level_of, read_frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.multiplex import FilterTrial, Frontier, Modulator

LEFT = ("CYMG", "CYYM", "Sony", "RGBW", "RGBW 4x4", "CMYW", "X-Trans", "Bayer")
RIGHT = ("lenslet", "MURA", "pinhole", "sum_of_sinusoids")
PICTURED = ("Bayer", "X-Trans", "MURA:11", "sum_of_sinusoids:11", "lenslet:3*Bayer")
FIGURES = ("figure3", "figure5", "figure6", "figure7")

SIDE = 11
"""Super-pixel of figure 6."""


def gains(chosen: list[Modulator], base: Modulator, marks: Mapping[str, float], out: Path, curves: Any) -> None:
    """Draw the gains of ``chosen`` over ``base``."""
    from lfcal.multiplex import save_gain_curves

    save_gain_curves([("", curves(chosen, base, cameras=marks))], out)


def show_frontier(frontier: Frontier, *, json: bool, stopped: bool = False) -> None:
    """Print the efficient candidates and the best at the camera's chi^2, also of a search that was ``stopped``."""
    import numpy as np

    best = int(np.argmax(frontier.chosen))
    order = [int(k) for k in np.argsort(-frontier.chosen) if frontier.efficient[k] or k == best]
    rows: list[dict[str, Any]] = [
        {
            "name": frontier.modulators[k].name,
            "gain_db": float(frontier.chosen[k]),
            "gain_additive_db": float(frontier.additive[k]),
            "gain_photon_db": float(frontier.photon[k]),
        }
        for k in order
    ]
    if json:
        print_json(
            {
                "reference": frontier.reference,
                "chi2": frontier.chi2,
                "candidates": len(frontier.modulators),
                "frontier": rows,
                "best": frontier.best.matrix,
                "bound_db": frontier.bound,
                "stopped": stopped,
            }
        )
        return
    headers = ["modulator", f"gain at χ² = {frontier.chi2:.4g} (dB)", "additive (dB)", "photon (dB)"]
    cells = [[r["name"], *(f"{r[k]:+.3f}" for k in ("gain_db", "gain_additive_db", "gain_photon_db"))] for r in rows]
    title = f"Gain over {frontier.reference}: {len(rows)} of {len(frontier.modulators)} candidates nothing beats"
    print_table(headers, cells, title=title)
    if frontier.bound is not None:
        left = frontier.bound - float(frontier.chosen[best])
        report(f"no mask of this size gains more than {frontier.bound:+.3f} dB: at most {left:.3f} dB are left")


def filter_choice(size: int, out: Path | None, *, json: bool) -> None:
    """Measure every route and filter on two scenes, print and draw them."""
    from lfcal.multiplex import cfa, colour_edges, measure_filters, zone_plate

    scenes = (("smooth zone plate", zone_plate((size, size), 0.2)), ("sharp edges", colour_edges((size, size))))
    found = [(name, measure_filters(scene, cfa("Bayer"))) for name, scene in scenes]
    if out is not None:
        from lfcal.multiplex import save_filter_choice

        save_filter_choice(found, out)
    if json:
        print_json(dict(found))
        return
    for name, trials in found:
        rows = [
            [t.name, f"{1e3 * t.seconds:.1f}", f"{100 * t.error:.2f}", *_ringing(t), "yes" if t.efficient else ""]
            for t in trials
        ]
        headers = ["way", "time (ms)", "rms error (%)", "ringing in flat parts (%)", "overshoot (%)", "efficient"]
        print_table(headers, rows, title=f"{name}, Bayer, {size} x {size} px; shares of the scene's range")


def _ringing(trial: FilterTrial) -> tuple[str, str]:
    found = trial.ringing
    return ("—", "—") if found is None else (f"{100 * found.flat:.2f}", f"{100 * found.overshoot:.1f}")


def figure_files(folder: Path) -> list[Path]:
    """Return the files that `iter_paper_figures` writes."""
    modulators = (name.replace(":", "").replace("*", "_") for name in PICTURED)
    return [folder / f"{name}.png" for name in (*FIGURES, *(f"modulator_{name}" for name in modulators))]


def iter_paper_figures(folder: Path, raw: Path | None, marks: Mapping[str, float], seed: int) -> Work[list[Path]]:
    """Draw figures 3, 5, 6 and 7 and the modulators into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    works: list[Callable[[Path], None]] = [
        lambda p: _figure3(p, raw),
        _figure5,
        lambda p: _figure6(p, marks),
        lambda p: _figure7(p, seed),
        *(lambda p, n=name: _modulator(p, n) for name in PICTURED),
    ]
    files = figure_files(folder)
    clock = Clock("figures", len(works))
    for k, (path, draw) in enumerate(zip(files, works, strict=True)):
        yield clock.at(k, path.name)
        draw(path)
    yield clock.at(len(works))
    return files


def _modulator(path: Path, name: str) -> None:
    from lfcal.multiplex import draw_modulator, modulator_of

    draw_modulator(modulator_of(name), path)


def _figure3(path: Path, raw: Path | None) -> None:
    from lfcal.multiplex import cfa, save_colour_routes

    if raw is None:
        _paper(3, path)
        return
    from lfcal.multiplex import without_black_level

    recorded = read_frame(raw)
    pattern = recorded.filters
    if not pattern:
        raise InputError.expected(
            f"{raw}", "a RAW file that names its colour filters", "none", "give another for --raw"
        )
    frame = without_black_level(recorded.raw, level_of(recorded, None))
    rows, columns = (n // 2 for n in frame.shape)
    zoom = (slice(rows - rows // 8, rows + rows // 8), slice(columns - columns // 8, columns + columns // 8))
    ways = (("spatial", "cubic"), ("spatial", "bilateral"), ("fourier", "sinc"))
    save_colour_routes(frame, cfa(pattern), path, zoom=zoom, others=_opencv(frame, pattern), ways=ways)


def _opencv(frame: NDArray[Any], pattern: str) -> list[tuple[str, NDArray[Any]]]:
    """Return OpenCV's bilinear demosaic of a Bayer frame, nothing for other patterns."""
    import cv2
    import numpy as np

    code = getattr(cv2, f"COLOR_Bayer{pattern}2RGB", None) if len(pattern) == 4 else None
    if code is None:
        return []
    whole = np.clip(np.rint(frame), 0, 65535).astype(np.uint16)
    return [("OpenCV, bilinear", cv2.demosaicing(whole, code).transpose(2, 0, 1))]


def _paper(number: int, path: Path, seed: int = 1) -> None:
    from lfcal.multiplex import paper_figure, save_paper_figure

    save_paper_figure(paper_figure(number, seed=seed), path)


def _figure5(path: Path) -> None:
    _paper(5, path)


def _figure6(path: Path, marks: Mapping[str, float]) -> None:
    from lfcal.multiplex import cfa, gain_curves, mask, save_gain_curves

    left = gain_curves([cfa(name) for name in LEFT], cfa("Bayer"), cameras=marks)
    right = gain_curves([mask(kind, SIDE) for kind in RIGHT], mask("pinhole", SIDE), cameras=marks)
    save_gain_curves([("colour filter arrays", left), (f"light-field modulators, {SIDE} x {SIDE}", right)], path)


def _figure7(path: Path, seed: int) -> None:
    _paper(7, path, seed)
