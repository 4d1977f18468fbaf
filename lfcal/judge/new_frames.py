"""New frames of point sources for checking an old H, with the positions of their sources if known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, format_pixels
from lfcal.camera import ScanPlan
from lfcal.fit import NewFrame, spread_out
from lfcal.frames import FrameSource, NamePattern
from lfcal.judge.expected import plan_of
from lfcal.psf import PSFMatrix

__all__ = ["new_frame", "new_frames"]

NAMES = ("*z{z}_y{y}_x{x}.*", "*y{y}_x{x}.*")
"""Patterns of the names of single files that state the position of their source."""

NEAR_DEPTH = 0.02
"""Largest relative difference between a depth and the depth of its plane in H."""


def new_frames(
    matrix: PSFMatrix, view: FrameSource, source: str, plan: ScanPlan | None = None, *, most: int = 0
) -> list[NewFrame]:
    """Return frames for checking H, with the positions of their sources where these are known.

    Parameters
    ----------
    matrix
        The old H.
    view
        Corrected frames in the orientation and pixels of the sensor.
    source
        Name for messages.
    plan
        Plan of the scan of the frames. None: each frame is a single file, whose name may state the position of its
        source.
    most
        Largest number of frames to return, spread evenly over ``view``; 0: all.

    Raises
    ------
    InputError
        If the size of the frames or of the sensor of ``plan`` does not match the sensor of H. Also if a depth of
        ``plan`` is not among those of H.
    """
    _check_grid(matrix, view, plan or plan_of(matrix), source)
    if plan is None:
        chosen = np.unique(np.linspace(0, len(view) - 1, most or len(view)).astype(int))
        return [_of_file(matrix, view, k) for k in chosen.tolist()]
    index: NDArray[np.intp] = np.array([tuple(view.info(k).position) for k in range(len(view))], np.intp).reshape(-1, 3)
    taken = spread_out(index, most, plan.period) if most and len(index) > most else np.arange(len(index))
    return [_of_scan(matrix, view, plan, k) for k in taken.tolist()]


def _check_grid(H: PSFMatrix, view: FrameSource, plan: ScanPlan | None, source: str) -> None:
    """Raise `InputError` unless the frames have the pixels of the sensor of H."""
    if H.camera is None:
        return
    wanted = H.camera.sensor.shape
    origin = view.info(0).origin
    if origin == (0, 0) and view.shape != wanted and (plan is None or plan.camera.sensor.shape != view.shape):
        raise InputError.expected(
            f"{source}, size",
            f"{format_pixels(wanted)}, as in the camera of H",
            format_pixels(view.shape),
            "give whole frames of this camera",
        )
    if plan is not None and plan.camera.sensor.shape != wanted:
        got = plan.camera.sensor.shape
        raise InputError.expected(
            f"{source}, sensor",
            f"{format_pixels(wanted)}, as in the camera of H",
            format_pixels(got),
            "give the H of this sensor",
        )


def _of_scan(H: PSFMatrix, view: FrameSource, plan: ScanPlan, k: int) -> NewFrame:
    info = view.info(k)
    z, y, x = info.position
    drift = info.drift or (0.0, 0.0)
    place = (plan.anchor[0] + y + drift[0], plan.anchor[1] + x + drift[1])
    depth = plan.depths_um[z]
    nearest = int(np.abs(H.depths - depth).argmin())
    if abs(float(H.depths[nearest]) - depth) > NEAR_DEPTH * max(abs(depth), 1.0):
        got = f"{depth:.6g} µm"
        wanted = "a depth of H, " + ", ".join(f"{v:.6g}" for v in H.depths[:6]) + " µm"
        raise InputError.expected(f"{info.label}, depth", wanted, got, "give an H with this depth")
    return new_frame(view, k, info.label, place, nearest)


def _of_file(H: PSFMatrix, view: FrameSource, k: int) -> NewFrame:
    label = view.info(k).label
    found = next((at for one in NAMES if (at := NamePattern(one).parse(label)) is not None), None)
    nz, ny, nx = H.shape[:3]
    if found is None or not (found[0].z < nz and found[0].y < ny and found[0].x < nx):
        return new_frame(view, k, label, plane=0 if nz == 1 else None)
    z, y, x = found[0]
    named = NamePattern(NAMES[0]).parse(label) is not None
    return new_frame(view, k, label, (H.anchor[0] + y, H.anchor[1] + x), z if named or nz == 1 else None)


def new_frame(
    view: FrameSource, k: int, label: str, place: tuple[float, float] | None = None, plane: int | None = None
) -> NewFrame:
    """Return frame ``k`` of a corrected view, with its noise and the position of its source.

    ``label`` is the name of the frame for messages. ``place`` (row, column; px) and ``plane`` are as in `NewFrame`.
    """
    samples = view.samples(k)
    noise = None
    if samples.noise is not None:
        typical = samples.noise.typical(samples.values)
        noise = (float(typical.constant), float(typical.slope))
    values = np.asarray(samples.values, np.float32)
    return NewFrame(values, samples.valid, noise, view.info(k).origin, place, plane, label)
