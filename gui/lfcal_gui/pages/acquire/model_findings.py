"""What was found by moving, in words. No Qt."""

from __future__ import annotations

import math

from lfcal.acquire.setup import OpticalAxis, StageFit, check_stage
from lfcal.base import InputError, format_length, format_seconds
from lfcal.camera import ScanPlan

__all__ = ["axis_words", "exposure_words", "fit_words"]


def fit_words(fit: StageFit, plan: ScanPlan) -> tuple[str, bool]:
    """Return the fit of the stage as rich text, and whether the plan agrees with it."""
    try:
        check_stage(fit, plan)
        verdict, good = "<b>The stage moves the image as the plan says.</b>", True
    except InputError as error:
        verdict, good = f"<b>{error}</b>", False
    right, down = fit.scale
    axes = fit.axes
    return (
        f"{verdict}<br>scale right {right:.4f}, down {down:.4f} (1: as planned); rotation "
        f"{math.degrees(fit.rotation_rad):+.2f}°; residual {fit.residual_px:.3f} px rms<br>image right is stage "
        f"{axes.right}, down {axes.down}"
    ), good


def axis_words(axis: OpticalAxis, plan: ScanPlan) -> str:
    """Return where the optical axis is, as rich text."""
    right, down = axis.object_um
    row, column = axis.image_px
    off = [p - c for p, c in zip(axis.image_px, plan.camera.sensor.centre_px, strict=True)]
    return (
        f"<b>Optical axis</b> at right {format_length(right)}, down {format_length(down)} from the plan's origin; "
        f"image at row {row:.1f}, column {column:.1f} px ({off[0]:+.1f}, {off[1]:+.1f} px from the sensor's centre); "
        f"residual {axis.residual_px:.2f} px rms"
    )


def exposure_words(found: tuple[float, ...], plan: ScanPlan) -> str:
    """Return the exposure of each plane as rich text."""
    rows = "".join(
        f"<tr><td style='padding-right:10px'>{format_length(z)}</td><td><b>{format_seconds(t)}</b></td>"
        f"<td style='padding-left:10px'>was {format_seconds(old)}</td></tr>"
        for z, t, old in zip(plan.depths_um, found, plan.exposures, strict=True)
    )
    return f"<b>Exposure for 70 % of the range</b><table>{rows}</table>"
