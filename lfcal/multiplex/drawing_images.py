"""Reconstructions side by side, and how frames and colours are shown (matplotlib, loaded when drawn)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import draw_image, figure, save_figure
from lfcal.multiplex.demultiplexing import demultiplex
from lfcal.multiplex.modulator import Modulator

__all__ = [
    "colour_picture",
    "log_spectrum",
    "mosaic_picture",
    "save_colour_routes",
    "upsampled_views",
]

Path = str | os.PathLike[str]
Image = NDArray[Any]


def colour_picture(samples: ArrayLike, *, top: float | None = None, gains: Sequence[float] = (1, 1, 1)) -> Image:
    """Return three colour samples ``(3, rows, columns)`` as float ``(rows, columns, 3)`` in 0 … 1 for display.

    ``top`` is shown as white (by default the 99.8th percentile), ``gains`` balance the colours first; values are
    displayed with a gamma of 1/2.2.
    """
    light = np.asarray(samples, float) * np.asarray(gains, float)[:, None, None]
    # the percentile keeps single hot pixels from making everything else dark
    white = float(np.percentile(light, 99.8)) if top is None else top
    shown: Image = np.clip(light / max(white, 1e-30), 0, 1).transpose(1, 2, 0) ** (1 / 2.2)
    return shown


def mosaic_picture(frame: ArrayLike, modulator: Modulator) -> Image:
    """Return a raw frame as ``(rows, columns, 3)`` with each pixel in the colour of its filter, in 0 … 1."""
    image = np.asarray(frame, float)
    pattern = modulator.pattern()
    shares = pattern if pattern.shape[2] == 3 else np.repeat(pattern, 3, 2)
    tiles = [-(-n // s) for n, s in zip(image.shape, modulator.side, strict=True)]
    colours = np.tile(shares / max(1.0, float(shares.max())), (*tiles, 1))[: image.shape[0], : image.shape[1]]
    white = max(float(np.percentile(image, 99.8)), 1e-30)
    shown: Image = np.clip(image / white, 0, 1)[..., None] ** (1 / 2.2) * colours
    return shown


def log_spectrum(frame: ArrayLike) -> Image:
    """Return the logarithm (base 10) of a frame's spectrum over its mean, zero frequency in the middle."""
    image = np.asarray(frame, float)
    # a window, because the frame's edges would draw a bright cross through the spectrum
    window = np.hanning(image.shape[0])[:, None] * np.hanning(image.shape[1])
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(image * window)))
    shown: Image = np.log10(np.maximum(spectrum / max(float(spectrum.max()), 1e-300), 1e-6))
    return shown


def save_colour_routes(
    frame: ArrayLike,
    modulator: Modulator,
    path: Path,
    *,
    zoom: tuple[slice, slice],
    others: Sequence[tuple[str, Image]] = (),
    ways: Sequence[tuple[str, str]] = (("spatial", "cubic"), ("fourier", "sinc")),
    gains: Sequence[float] = (1, 1, 1),
) -> None:
    """Write figure 3: raw frame, its spectrum, and each reconstruction whole and magnified.

    Parameters
    ----------
    frame, modulator
        A mosaic, background subtracted, and its colour filter array.
    path
        PNG or another format by suffix.
    zoom
        Rows and columns that are magnified.
    others
        Title and colours ``(3, rows, columns)`` of further reconstructions.
    ways
        Routes and filters.
    gains
        Balance of red, green and blue for display.
    """
    image = np.asarray(frame, float)
    results = [
        (
            f"{route}, {name}" if route == "spatial" else "Fourier",
            demultiplex(image, modulator, route=route, filter=name),
        )
        for route, name in ways
    ] + list(others)
    # one white for all results, so that their brightness can be compared
    top = float(np.percentile(results[0][1] * np.asarray(gains)[:, None, None], 99.8))
    with figure(3.6 * (1 + len(results)), 5.6, dpi=150) as fig:
        grid = fig.subplots(2, 1 + len(results), squeeze=False)
        _show(grid[0, 0], mosaic_picture(image, modulator)[zoom], "raw frame, magnified", zoom)
        draw_image(
            grid[1, 0],
            log_spectrum(image),
            title="spectrum of the raw frame",
            unit="log10, relative",
            extent=(-0.5, 0.5, 0.5, -0.5),
            xlabel="cycles per pixel, x",
            ylabel="cycles per pixel, y",
        )
        for k, (title, colours) in enumerate(results, 1):
            picture = colour_picture(colours, top=top, gains=gains)
            _show(grid[0, k], picture, title)
            _show(grid[1, k], picture[zoom], f"{title}, magnified", zoom)
        save_figure(fig, path)


def _show(axes: Any, picture: Image, title: str, zoom: tuple[slice, slice] | None = None) -> None:
    extent = None
    if zoom is not None:
        rows, columns = zoom
        extent = (columns.start - 0.5, columns.stop - 0.5, rows.stop - 0.5, rows.start - 0.5)
    axes.imshow(np.clip(picture, 0, 1), extent=extent, interpolation="nearest")
    axes.grid(False)
    axes.set(title=title, xlabel="column (px)", ylabel="row (px)")


def upsampled_views(frame: ArrayLike, modulator: Modulator, factor: int = 3) -> list[tuple[str, Image]]:
    """Return the views ``factor`` times upsampled in the three ways of figure 5, each ``(N, rows, columns)``.

    Zero-padded Fourier reconstruction; Fourier reconstruction at low resolution, then bicubic; bicubic interpolation
    of the measurement channels, then decorrelation.
    """
    import cv2

    image = np.asarray(frame, float)
    small = demultiplex(image, modulator, route="fourier", samples=1)
    size = (small.shape[2] * factor, small.shape[1] * factor)
    bicubic = np.stack([cv2.resize(view, size, interpolation=cv2.INTER_CUBIC) for view in small])
    return [
        ("zero-padded Fourier", demultiplex(image, modulator, route="fourier", samples=factor)),
        ("Fourier, then bicubic", bicubic),
        ("bicubic channels, then decorrelation", demultiplex(image, modulator, filter="cubic", samples=factor)),
    ]
