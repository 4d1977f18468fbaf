"""Descriptions of an inspection for users: costs and comparisons as text, and plots of faults."""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING

import numpy as np

from lfcal.base import LINES, draw_image, figure
from lfcal.judge.fault import FaultPicture, FoundFault
from lfcal.judge.inspection import Inspection

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["compared_words", "cost_words", "draw_picture", "drawn"]


def cost_words(inspection: Inspection, finding: FoundFault) -> str:
    """Return the reconstruction error (NRMSE) due to noise alone, and due to noise and a fault together, as text.

    If either is unknown, the text is "not measured".
    """
    if finding.cost is None or inspection.clean is None:
        return "not measured"
    return f"{inspection.clean:.3f} → {math.hypot(inspection.clean, finding.cost):.3f}"


def scene_words(inspection: Inspection) -> str:
    """Return the reconstruction errors with H as it is and with its noise alone, as text; empty if not measured."""
    if inspection.clean is None or inspection.as_it_is is None:
        return ""
    return (
        f"a fixed scene is reconstructed with an error (NRMSE) of {inspection.as_it_is:.3f} with H as it is, "
        f"{inspection.clean:.3f} with its noise alone"
    )


def compared_words(inspection: Inspection) -> str:
    """Return the number of patterns compared with the camera and the result, or why none were compared, as text."""
    if not inspection.compared:
        weaker = "the checks below are less sensitive than a comparison"
        if inspection.faults:
            weaker = f"the patterns alone show these faults; {weaker}"
        if inspection.disagreement is not None:
            return f"the camera disagrees: {inspection.why_not}; {weaker}"
        return f"not compared with a camera: {inspection.why_not}; {weaker}"
    scope = f"{inspection.compared} patterns compared with the camera"
    if not inspection.faults:
        return f"{scope}: no fault found"
    scene = scene_words(inspection)
    return f"{scope}: these faults were found" + (f"; {scene}" if scene else "")


def draw_picture(axes: Axes, picture: FaultPicture) -> None:
    """Draw the evidence of a fault, which is a map or a curve, in ``axes``."""
    values = np.asarray(picture.values, float)
    if values.ndim == 2:
        (rows, columns), (top, left) = picture.axes, picture.origin
        extent = (left - 0.5, left + values.shape[1] - 0.5, top + values.shape[0] - 0.5, top - 0.5)
        draw_image(axes, values, title=picture.title, unit=picture.unit, xlabel=columns, ylabel=rows, extent=extent)
        axes.set_aspect("auto")
        return
    across = np.arange(len(values)) if picture.across is None else picture.across
    axes.plot(across, values, color=LINES[0], lw=1, marker="o" if len(values) < 40 else None, ms=3)
    axes.set_title(picture.title)
    axes.set_xlabel(picture.axes[0])
    axes.set_ylabel(picture.unit)


def drawn(picture: FaultPicture) -> bytes:
    """Return a plot of the evidence of a fault as PNG bytes."""
    out = io.BytesIO()
    with figure(5.2, 3.4) as fig:
        draw_picture(fig.add_subplot(), picture)
        fig.savefig(out, format="png")
    return out.getvalue()
