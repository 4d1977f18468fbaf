"""Plots as files, in one style for the whole library (matplotlib is loaded only when needed)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from lfcal.base.files import replace_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["COLOURS", "LINES", "draw_image", "figure", "save_figure"]

LINES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#333333")
"""Line colours that colour-blind readers can distinguish (Okabe-Ito)."""

COLOURS = {"good": "#2e7d32", "fair": "#b26a00", "bad": "#c62828", "muted": "#6b7280", "accent": "#0b6e99"}
"""Colours by meaning, shared by reports and the window."""

IMAGE_MAP = "viridis"
"""Perceptually uniform colour map for intensities."""

DIFFERENCE_MAP = "RdBu_r"
"""Colour map for signed differences, symmetric about zero."""

_STYLE: dict[str, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e5e7eb",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "image.cmap": IMAGE_MAP,
    "image.interpolation": "nearest",
}


@contextmanager
def figure(width: float = 6.4, height: float = 4.0, dpi: int = 130) -> Iterator[Figure]:
    """Yield an empty figure of ``width`` x ``height`` inches in the common style, without pyplot.

    Matplotlib's settings are those of the style only within the block. At its end, the figure is cleared.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(cast(Any, _STYLE)):
        fig = Figure(figsize=(width, height), dpi=dpi, layout="constrained")
        FigureCanvasAgg(fig)
        yield fig
        fig.clear()


def save_figure(fig: Figure, path: str | os.PathLike[str], *, colours: int = 0) -> None:
    """Write ``fig`` atomically, in the format of the suffix of ``path``; without a suffix, as a PNG.

    ``colours`` limits the number of colours in a PNG (at most 256), which makes the file several times smaller; 0: no
    limit.
    """
    suffix = os.path.splitext(os.fspath(path))[1].lstrip(".").lower() or "png"
    with replace_whole(path) as part:
        fig.savefig(part, format=suffix)
        if colours and suffix == "png":
            from PIL import Image

            with Image.open(part) as drawn:
                few = drawn.convert("RGB").quantize(colours, dither=Image.Dither.NONE)
            few.save(part, format="PNG", optimize=True)


def draw_image(
    axes: Axes,
    image: ArrayLike,
    *,
    title: str = "",
    unit: str = "",
    xlabel: str = "column s (px)",
    ylabel: str = "row t (px)",
    signed: bool = False,
    extent: tuple[float, float, float, float] | None = None,
) -> None:
    """Draw a 2-D array with a colour bar and axis labels; ``signed`` centres the colour map on zero.

    ``unit`` is the label of the colour bar, and ``extent`` is that of `matplotlib.axes.Axes.imshow`.
    """
    data = np.asarray(image, dtype=float)
    finite = data[np.isfinite(data)]
    limit = float(np.abs(finite).max()) if finite.size else 1.0
    kwargs: dict[str, Any] = {"extent": extent, "aspect": "equal"}
    if signed:
        kwargs |= {"cmap": DIFFERENCE_MAP, "vmin": -limit or -1.0, "vmax": limit or 1.0}
    shown = axes.imshow(data, **kwargs)
    axes.grid(False)
    axes.set_title(title)
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    bar = axes.figure.colorbar(shown, ax=axes, shrink=0.85)  # type: ignore[union-attr,unused-ignore]
    bar.set_label(unit)
