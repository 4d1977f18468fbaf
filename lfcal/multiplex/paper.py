"""Figures 3, 5, 6 and 7 of Ihrke et al. 2010 as data and PNG files, with common scales and numbers for each image."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, draw_image, figure, save_figure
from lfcal.multiplex.acquisition import acquire_light_field
from lfcal.multiplex.colour_filters import cfa
from lfcal.multiplex.demultiplexing import demultiplex, multiplex
from lfcal.multiplex.drawing import colour_picture, log_spectrum, mosaic_picture, upsampled_views
from lfcal.multiplex.masks import mask
from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.noise import PAPER_CAMERAS, GainCurves, gain_curves, snr_gain
from lfcal.multiplex.quality import ringing
from lfcal.multiplex.scenes import colour_edges, filament_light_field, view_edges

__all__ = ["FIGURES", "PaperFigure", "PaperPanel", "paper_figure", "save_paper_figure"]

Array = NDArray[Any]

FIGURES = (3, 5, 6, 7)
SIDE = 11
UPSAMPLED = 7
FACTOR = 3
BLUR = 0.45
"""Width of the edges in figure 5 (rms, super-pixels)."""

CELLS = (30, 36)
INNER = np.s_[6:-6, 6:-6]
"""Samples that are compared in figure 5: all except six at each border."""

PATTERNS = ("CYMG", "CYYM", "Sony", "RGBW", "CMYW", "Bayer")
LIGHT_FIELD = ("lenslet", "MURA", "pinhole", "sum_of_sinusoids")


@dataclass(frozen=True, eq=False)
class PaperPanel:
    """One image of a figure.

    Attributes
    ----------
    title
        Title of the image.
    image
        Grey image ``(rows, columns)``, or colours ``(rows, columns, 3)`` in 0 … 1.
    numbers
        One-line text that states error, ringing or signal-to-noise ratio.
    levels
        Values shown as black and as white, equal for all images to be compared; None for colour images.
    """

    title: str
    image: Array = field(repr=False)
    numbers: str
    levels: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class PaperFigure:
    """A reproduced figure of Ihrke et al. 2010, which consists of images or of curves.

    Attributes
    ----------
    number
        Number of the figure in Ihrke et al. 2010: 3, 5, 6 or 7.
    title
        Title of the figure.
    panels
        Images in row-major order, with ``columns`` images in each row; empty in figure 6.
    columns
        Number of images in a row.
    curves
        Pairs of a title and `GainCurves`, one for each plot; only in figure 6.
    """

    number: int
    title: str
    panels: tuple[PaperPanel, ...] = ()
    columns: int = 1
    curves: tuple[tuple[str, GainCurves], ...] = field(default=(), repr=False)


def paper_figure(number: int, *, camera: str = "", chi2: float | None = None, seed: int = 1) -> PaperFigure:
    """Return a figure of Ihrke et al. 2010, reproduced with synthetic scenes instead of the paper's own images.

    Parameters
    ----------
    number
        Number of the figure: 3, 5, 6 or 7.
    camera, chi2
        Name and chi^2 of a camera, which is marked in figure 6 and used in figure 7. None: in figure 7, the PG
        Dragonfly of the paper, which is always marked in figure 6.
    seed
        Random seed of scene and noise in figure 7.
    """
    makers: dict[int, Callable[[], PaperFigure]] = {
        3: _routes,
        5: _upsampling,
        6: lambda: _gains(camera, chi2),
        7: lambda: _acquired(camera, chi2, seed),
    }
    if number not in makers:
        raise InputError.expected("figure", "3, 5, 6 or 7", number, "choose one of these")
    return makers[number]()


def _routes() -> PaperFigure:
    modulator, truth = cfa("Bayer"), colour_edges((192, 240))
    frame, zoom = multiplex(truth, modulator), np.s_[:, 52:92, 82:132]
    found = [
        ("spatial, directional", demultiplex(frame, modulator)),
        ("spatial, cubic", demultiplex(frame, modulator, filter="cubic")),
        ("Fourier", demultiplex(frame, modulator, route="fourier")),
    ]
    top = float(truth.max())
    spectrum = log_spectrum(frame)
    panels = [
        PaperPanel(
            "recorded frame, magnified",
            mosaic_picture(frame, modulator)[zoom[1:]],
            "pixels in filter colours",
        ),
        PaperPanel("spectrum", spectrum, "log10, relative", (-6.0, 0.0)),
        PaperPanel("ground truth, magnified", colour_picture(truth[zoom], top=top), "the scene"),
    ]
    for name, colours in found:
        rings = ringing(colours, truth, modulator.side)
        ring = f"uniform parts {100 * rings.flat:.2f} %, overshoot {100 * rings.overshoot:.0f} %"
        words = f"rms {_percent(colours - truth)}, {ring}"
        panels.append(PaperPanel(name, colour_picture(colours[zoom], top=top), words))
    return PaperFigure(3, "Bayer pattern: reconstruction by both theorems", tuple(panels), 3)


def _percent(error: Array, span: float = 1.0) -> str:
    return f"{100 * float(np.sqrt(np.mean(error**2))) / span:.2f} %"


def _upsampling() -> PaperFigure:
    from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

    from lfcal.base import cv2

    # edges as sharp as a super-pixel, because no modulator of this size can resolve sharper ones
    sharp = view_edges(UPSAMPLED, CELLS)
    truth = np.stack([cv2.GaussianBlur(view, (0, 0), BLUR * UPSAMPLED) for view in sharp])
    middle = len(truth) // 2
    places = [(np.arange(n * FACTOR) + 0.5) * UPSAMPLED / FACTOR - 0.5 for n in CELLS]
    wanted = map_coordinates(truth[middle], np.meshgrid(*places, indexing="ij"), order=1, mode="nearest")
    levels, span = (float(truth[middle].min()), float(truth[middle].max())), float(np.ptp(truth[middle]))
    size = 2 * FACTOR + 1  # uniform within a super-pixel on each side, so any variation there is ringing
    even = (maximum_filter(wanted, size) - minimum_filter(wanted, size) < 0.02 * span)[INNER]
    kinds = ("sum_of_sinusoids", "MURA")
    ways: list[list[PaperPanel]] = [[], [], []]
    for kind in kinds:
        modulator = mask(kind, UPSAMPLED)
        for row, (name, views) in zip(
            ways, upsampled_views(multiplex(truth, modulator), modulator, FACTOR), strict=True
        ):
            error = (views[middle] - wanted)[INNER]
            rings = _percent(error[even], span)
            words = (
                f"rms {_percent(error, span)}, uniform parts {rings}, worst {100 * np.abs(error).max() / span:.0f} %"
            )
            row.append(PaperPanel(f"{_plain(kind)}: {name}", views[middle], words, levels))
    order = [ways[row][column] for column in range(2) for row in range(3)]
    return PaperFigure(5, "Middle view, upsampled three times", tuple(order), 3)


def _plain(kind: str) -> str:
    return kind.replace("_", " ")


def _gains(camera: str, chi2: float | None) -> PaperFigure:
    marks = {} if chi2 is None else {camera or "camera": chi2}
    left = gain_curves([cfa(name) for name in PATTERNS], cfa("Bayer"), cameras=marks)
    right = gain_curves([mask(kind, SIDE) for kind in LIGHT_FIELD], mask("pinhole", SIDE), cameras=marks)
    titles = (
        "colour filter arrays compared with Bayer",
        f"light-field modulators of {SIDE} x {SIDE} compared with a pinhole",
    )
    return PaperFigure(6, "Gain in signal-to-noise ratio", curves=tuple(zip(titles, (left, right), strict=True)))


def _acquired(camera: str, chi2: float | None, seed: int) -> PaperFigure:
    rng = np.random.default_rng(seed)
    ratio = next(iter(PAPER_CAMERAS.values())) if chi2 is None else chi2
    modulators, hole = [mask(kind, SIDE) for kind in LIGHT_FIELD], mask("pinhole", SIDE)
    scene = filament_light_field(SIDE, CELLS, rng)
    results = acquire_light_field(scene, modulators, chi2=max(ratio, 1e-6), signal_e=1e7, rng=rng)
    middle = SIDE * SIDE // 2
    scale = SIDE * SIDE  # light of a view relative to the mean view
    high = 1.1 * scale * max(float(r.truth[middle].max()) for r in results)
    close, views = [], []
    for r in results:
        name = _plain(r.modulator.name)
        gain = snr_gain(r.modulator, hole, ratio)
        part = _contrast(r.frame, r.modulator)
        low, top = (float(v) for v in np.percentile(part, (1, 99)))
        words = f"relative to the mean of a super-pixel, {100 * (low - 1):+.1f} to {100 * (top - 1):+.1f} %"
        close.append(PaperPanel(f"{name}: frame", part, words, (low, top)))
        words = f"SNR {r.snr_db:.1f} dB, forecast {gain:+.1f} dB relative to a pinhole"
        views.append(PaperPanel(f"{name}: middle view", scale * r.views[middle], words, (0.0, high)))
    who = f"{camera or 'camera'}" if chi2 is not None else next(iter(PAPER_CAMERAS))
    title = f"A light field recorded with four modulators; noise of {who} (χ² = {ratio:.3g}), equal exposure"
    return PaperFigure(7, title, (*close, *views), len(LIGHT_FIELD))


def _contrast(frame: Array, modulator: Modulator) -> Array:
    """Return a magnified part of a frame divided by its mean over a super-pixel, to show where views differ."""
    from lfcal.base import cv2

    side = modulator.side[0]
    mean = cv2.blur(frame, (side, side), borderType=cv2.BORDER_REFLECT_101)
    a, b = (n // 2 for n in frame.shape)
    return np.asarray((frame / np.maximum(mean, 1e-12))[a : a + 5 * side, b : b + 5 * side])


def save_paper_figure(found: PaperFigure, path: str | os.PathLike[str]) -> None:
    """Write the images of a figure to a file; for figure 6, use `lfcal.multiplex.drawing.save_gain_curves`."""
    rows = -(-len(found.panels) // found.columns)
    with figure(3.7 * found.columns, 3.5 * rows + 0.4, dpi=140) as fig:
        grid = fig.subplots(rows, found.columns, squeeze=False).ravel()
        for axes, panel in zip(grid, found.panels, strict=False):
            _draw(axes, panel)
        for axes in grid[len(found.panels) :]:
            axes.set_axis_off()
        fig.suptitle(f"Figure {found.number}. {found.title}", fontsize=10)
        save_figure(fig, path)


def _draw(axes: object, panel: PaperPanel) -> None:
    from matplotlib.axes import Axes

    assert isinstance(axes, Axes)
    words = f"column\n{panel.numbers}"
    if panel.levels is None:
        axes.imshow(panel.image, interpolation="nearest")
        axes.grid(False)
        axes.set(title=panel.title, xlabel=words, ylabel="row")
        return
    draw_image(axes, panel.image, title=panel.title, unit="", xlabel=words, ylabel="row")
    axes.images[0].set_clim(*panel.levels)
