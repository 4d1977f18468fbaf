"""A display as a target: pixels are switched instead of moved, and frames may show several offsets together."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Work, check_number, check_tuple, format_pixels, storage_errors, write_png
from lfcal.camera import ScanPlan
from lfcal.targets.images import hole_images
from lfcal.targets.offsets import iter_whole_offsets
from lfcal.targets.phases import Phases
from lfcal.targets.plan import TargetPlan, lit_by
from lfcal.targets.planning import Wishes, iter_plan_target, propose_target
from lfcal.targets.pose import length_um
from lfcal.targets.target import Target

__all__ = [
    "Display",
    "coded_plan",
    "display_image",
    "iter_plan_display",
    "parse_display",
    "pictures_in",
    "write_pictures",
]

DISC = 2 / math.sqrt(3)
"""Ratio of the diameter of a disc to the side of a square pixel of the same rms width."""

EXAMPLE = "write it in the form display:2160x3840@8um"


@dataclass(frozen=True, slots=True)
class Display:
    """Display in the object space of a camera; the pixels of the display serve as point sources.

    Attributes
    ----------
    shape
        Number of rows and columns of the display.
    pixel_um
        Pitch of the pixels in object space (µm).

    Examples
    --------
    >>> from lfcal.targets import Display
    >>> display = Display((2160, 3840), pixel_um=8.0)
    >>> print([side * display.pixel_um / 1000 for side in display.shape], "mm")
    [17.28, 30.72] mm
    """

    shape: tuple[int, int]
    pixel_um: float

    def __post_init__(self) -> None:
        """Check every value."""
        shape = check_tuple("display (rows, columns)", self.shape, 2, integer=True, at_least=2, at_most=20_000)
        object.__setattr__(self, "shape", shape)
        check_number("pitch of the display's pixels (µm)", self.pixel_um, above=0)


def parse_display(text: str) -> Display | None:
    """Return the display described by ``"display:ROWSxCOLUMNS@PITCH"``; None if ``text`` describes something else.

    The pitch in object space is in µm, unless it ends in mm.

    Raises
    ------
    InputError
        If the text begins with ``display``, but is invalid.

    Examples
    --------
    >>> from lfcal.targets import parse_display
    >>> parse_display("display:2160x3840@0.05mm")
    Display(shape=(2160, 3840), pixel_um=50.0)
    >>> print(parse_display("array:12x12@1.2mm"))  # no display
    None
    """
    if not text.strip().startswith("display"):
        return None
    match = re.fullmatch(r"display:(\d{1,6})[x×](\d{1,6})@(.+)", text.strip())
    if match is None:
        raise InputError.expected("display", "display:ROWSxCOLUMNS@PITCH", repr(text), EXAMPLE)
    return Display((int(match[1]), int(match[2])), length_um(match[3]))


def iter_plan_display(scan: ScanPlan, display: Display, wishes: Wishes | None = None) -> Work[TargetPlan]:
    """Return a plan of the display pixels to light in each frame, so that few frames show most phases of a scan.

    Points and offsets are whole pixels of the display. If the image of a pixel is large compared with the tolerance, or
    ``wishes.most_frames`` is small, some phases are not shown. `TargetPlan.coverage` returns the fraction shown.
    ``wishes`` are the limits for the plan (None: the defaults).

    Raises
    ------
    InputError
        If the display or the sensor is too small for two points, or the crosstalk exceeds its limit.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.base import drain
    >>> from lfcal.targets import Display, Wishes, iter_plan_display
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> wishes = Wishes(tolerance_px=0.3, crosstalk=0.02, most_frames=3, level="geometric")
    >>> plan = drain(iter_plan_display(scan, Display((2000, 2000), pixel_um=10.0), wishes))
    >>> print(len(plan.frames), "frames; display pixels between points:", [um / 10.0 for um in plan.target.pitch_um])
    3 frames; display pixels between points: [83.0, 85.0]
    """
    wishes = wishes or Wishes()
    proposed = propose_target(scan, wishes, hole_um=DISC * display.pixel_um)
    target = _on_display(scan, display, proposed)
    # a plan of one frame, which checks that holes are visible and far enough apart
    plan = yield from iter_plan_target(scan, target, replace(wishes, most_frames=1))
    phases, offsets = Phases.of(scan), []
    for depth in scan.depths_um:
        unit = display.pixel_um / scan.camera.step_um(depth)
        images = hole_images(target, scan.camera, depth)
        found = yield from iter_whole_offsets(phases, images, wishes.tolerance_px, unit, wishes.most_frames)
        offsets.append(tuple((float(row), float(column)) for row, column in (found * unit).tolist()))
    return replace(plan, offsets_px=tuple(offsets))


def _on_display(scan: ScanPlan, display: Display, target: Target) -> Target:
    """Return the target with pitches of whole display pixels, and no more points than fit on the display."""
    pixel = display.pixel_um
    pitch = [math.ceil(one / pixel - 1e-9) for one in target.pitch_um]
    periods = [length * scan.camera.step_um(max(scan.depths_um)) / pixel for length in scan.camera.period_px]
    room = [1 + int((n - 2 * period - 1) // p) for n, p, period in zip(display.shape, pitch, periods, strict=True)]
    shape = [min(have, most) for have, most in zip(target.shape, room, strict=True)]
    if min(shape) < 1 or max(shape) < 2:
        need = " x ".join(f"{math.ceil(p + 2 * period + 1)}" for p, period in zip(pitch, periods, strict=True))
        raise InputError.expected(
            "display", f"room for two points and their motion: {need} pixels", display.shape, "choose a larger display"
        )
    return replace(target, shape=(shape[0], shape[1]), pitch_um=(pitch[0] * pixel, pitch[1] * pixel))


def coded_plan(plan: TargetPlan, code: NDArray[np.float64], pixel_um: float) -> TargetPlan:
    """Return a copy of ``plan`` whose frames each show several offsets together.

    Parameters
    ----------
    plan
        Plan with one frame for each offset.
    code
        Square matrix ``(n, n)`` of 0 and 1, such as an S-matrix. Offsets are divided into groups of n, and row k
        selects those that frame k of a group shows. Repeated offsets complete the last group.
    pixel_um
        Pixel pitch of the display in object space (µm). Repeated offsets are displaced vertically by a period of the
        lenslet array, rounded to whole pixels of the display.

    Raises
    ------
    InputError
        If a plane has fewer than n/2 offsets.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.multiplex import s_matrix
    >>> from lfcal.targets import Target, TargetPlan, coded_plan
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> plan = TargetPlan(scan, Target(), (((0.0, 0.0), (0.0, 5.0), (5.0, 0.0)),), 0.1, (0.0,), "geometric")
    >>> print(coded_plan(plan, s_matrix(3), pixel_um=8.0).lit)  # two of three offsets in each frame
    (((0, 1), (0, 2), (1, 2)),)
    """
    offsets, lit, scan = [], [], plan.scan
    for z, depth in enumerate(scan.depths_um):
        own = list(plan.offsets_px[z])
        unit = pixel_um / scan.camera.step_um(depth)
        period = round(scan.camera.period_px[0] / unit) * unit
        more = -len(own) % len(code)
        own += [(row + (-period if row > 0 else period), column) for row, column in own[:more]]
        if len(own) % len(code):
            wanted = f"at least {math.ceil(len(code) / 2)} offsets in plane {z}"
            raise InputError.expected(
                "target for coded frames", wanted, f"{len(plan.offsets_px[z])} offsets", "choose a shorter code"
            )
        offsets.append(tuple(own))
        lit.append(lit_by(code, len(own)))
    return replace(plan, offsets_px=tuple(offsets), lit=tuple(lit))


def display_image(plan: TargetPlan, display: Display, z: int, k: int) -> NDArray[np.uint8]:
    """Return the image on the display in frame ``k`` of plane ``z`` of ``plan``, as seen by the camera.

    The image is ``(rows, columns)`` uint8. Lit pixels are 255, and all others 0.

    Raises
    ------
    InputError
        If a point is outside the display.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import Display, TargetPlan, display_image, parse_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> plan = TargetPlan(scan, parse_target("array:2x3@400um"), (((0.0, 0.0),),), 0.1, (0.0,), "geometric")
    >>> print(np.argwhere(display_image(plan, Display((101, 101), pixel_um=10.0), 0, 0)).tolist())  # 40 pixels apart
    [[30, 10], [30, 50], [30, 90], [70, 10], [70, 50], [70, 90]]
    """
    out = np.zeros(display.shape, np.uint8)
    flat = plan.target.flat_um(plan.target.holes)
    for offset in plan.offsets_um(z)[list(plan.lit_in(z, k))]:
        right, down = ((flat + offset) / display.pixel_um).T
        middle = (np.array(display.shape) - 1) / 2
        # an even number of points about an odd number of pixels: all are displaced by half a pixel
        rows, columns = (np.floor(np.stack([down, right]) + middle[:, None] + 0.5 + 1e-6)).astype(np.intp)
        inside = (rows >= 0) & (columns >= 0) & (rows < display.shape[0]) & (columns < display.shape[1])
        if not inside.all():
            raise InputError.expected(
                "points",
                f"points within the {format_pixels(display.shape)} of the display",
                "some outside it",
                "plan the target again",
            )
        out[rows, columns] = 255
    return out


def pictures_in(folder: Path) -> list[Path]:
    """Return the paths of the images that `write_pictures` wrote to ``folder``, in the order of their numbers."""
    return sorted(folder.glob("frame_[0-9][0-9][0-9][0-9].png"))


def write_pictures(plan: TargetPlan, display: Display, folder: Path) -> list[Path]:
    """Write the image on the display for each frame as PNG, in the order of the plan; return the paths.

    Images of an earlier plan are removed, because a program that shows all files would also show them.
    """
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for earlier in pictures_in(folder):
            earlier.unlink()
    files = []
    for number, (z, k) in enumerate(plan.frames):
        path = folder / f"frame_{number:04d}.png"
        write_png(path, display_image(plan, display, z, k))
        files.append(path)
    return files
