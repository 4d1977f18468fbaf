"""Figures 3, 5, 6 and 7 of Ihrke et al. (CVPR 2010), and plots of modulators, as files in a folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work
from lfcal.multiplex._sensor_noise import without_black_level
from lfcal.multiplex.colour_filters import cfa
from lfcal.multiplex.drawing import draw_modulator, save_colour_routes, save_gain_curves
from lfcal.multiplex.masks import mask
from lfcal.multiplex.naming import modulator_of
from lfcal.multiplex.noise import gain_curves
from lfcal.multiplex.paper import paper_figure, save_paper_figure
from lfcal.multiplex.recorded import read_recorded

__all__ = ["figure_files", "iter_paper_figures"]

LEFT = ("CYMG", "CYYM", "Sony", "RGBW", "RGBW 4x4", "CMYW", "X-Trans", "Bayer")
RIGHT = ("lenslet", "MURA", "pinhole", "sum_of_sinusoids")
PICTURED = ("Bayer", "X-Trans", "MURA:11", "sum_of_sinusoids:11", "lenslet:3*Bayer")

SIDE = 11
"""Side of the super-pixel in figure 6 (pixels)."""


def figure_files(folder: Path) -> list[Path]:
    """Return the paths of the files that `iter_paper_figures` writes."""
    modulators = (f"modulator_{name.replace(':', '').replace('*', '_')}" for name in PICTURED)
    return [folder / f"{name}.png" for name in ("figure3", "figure5", "figure6", "figure7", *modulators)]


def iter_paper_figures(folder: Path, raw: Path | None, marks: Mapping[str, float], seed: int) -> Work[list[Path]]:
    """Draw figures 3, 5, 6 and 7 of Ihrke et al., and the modulators `PICTURED`; return the paths of the files.

    Parameters
    ----------
    folder
        Folder for the figures; created if it does not exist.
    raw
        RAW file for figure 3; the file must state its colour filters. None: a synthetic scene.
    marks
        chi^2 of cameras to mark in figure 6, by name.
    seed
        Random seed of the noise in figure 7.
    """
    folder.mkdir(parents=True, exist_ok=True)
    draws: list[Callable[[Path], None]] = [
        partial(_figure3, raw),
        _figure5,
        partial(_figure6, marks),
        partial(_figure7, seed),
        *(partial(draw_modulator, modulator_of(name)) for name in PICTURED),
    ]
    files = figure_files(folder)
    clock = Clock("figures", len(draws))
    for k, (path, draw) in enumerate(zip(files, draws, strict=True)):
        yield clock.at(k, path.name)
        draw(path)
    yield clock.at(len(draws))
    return files


def _figure3(raw: Path | None, path: Path) -> None:
    if raw is None:
        save_paper_figure(paper_figure(3), path)
        return
    recorded = read_recorded(raw)
    pattern = recorded.filters
    if not pattern:
        raise InputError.expected(
            f"{raw}",
            "a RAW file that states its colour filters",
            "none",
            "choose another file for the raw values (--raw)",
        )
    frame = without_black_level(recorded.raw, recorded.level())
    rows, columns = (n // 2 for n in frame.shape)
    zoom = (slice(rows - rows // 8, rows + rows // 8), slice(columns - columns // 8, columns + columns // 8))
    ways = (("spatial", "cubic"), ("spatial", "bilateral"), ("fourier", "sinc"))
    save_colour_routes(frame, cfa(pattern), path, zoom=zoom, others=_opencv(frame, pattern), ways=ways)


def _opencv(frame: NDArray[Any], pattern: str) -> list[tuple[str, NDArray[Any]]]:
    """Return OpenCV's bilinear demosaicing result for a Bayer frame; empty for other patterns."""
    from lfcal.base import cv2

    code = getattr(cv2, f"COLOR_Bayer{pattern}2RGB", None) if len(pattern) == 4 else None
    if code is None:
        return []
    whole = np.clip(np.rint(frame), 0, 65535).astype(np.uint16)
    return [("OpenCV, bilinear", cv2.demosaicing(whole, code).transpose(2, 0, 1))]


def _figure5(path: Path) -> None:
    save_paper_figure(paper_figure(5), path)


def _figure6(marks: Mapping[str, float], path: Path) -> None:
    left = gain_curves([cfa(name) for name in LEFT], cfa("Bayer"), cameras=marks)
    right = gain_curves([mask(kind, SIDE) for kind in RIGHT], mask("pinhole", SIDE), cameras=marks)
    save_gain_curves([("colour filter arrays", left), (f"light-field modulators, {SIDE} x {SIDE}", right)], path)


def _figure7(seed: int, path: Path) -> None:
    save_paper_figure(paper_figure(7, seed=seed), path)
