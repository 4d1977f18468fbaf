"""The pixels that H and the frames have in common: its anchor, its voxels, and frames resampled onto its period."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import Camera
    from lfcal.lattice import LatticeFit
    from lfcal.psf import PSFMatrix
    from lfcal.reconstruct import MetricGrid, Resampling

__all__ = ["anchor_of", "check_as_is", "grid_of", "known_view", "view_for", "view_of", "wide"]


def grid_of(text: str, H: PSFMatrix, shape: tuple[int, int], anchor: tuple[float, float] | None) -> MetricGrid | None:
    """Return the grid that ``--voxel`` asks for, ``auto`` or a number of µm; None: none.

    ``shape`` and ``anchor`` are those of the images, the anchor None where it is H's own.
    """
    from lfcal.base import InputError
    from lfcal.reconstruct import MetricGrid

    if not text:
        return None
    try:
        side = None if text == "auto" else float(text)
    except ValueError:
        raise InputError.expected("--voxel", "a number of µm, or auto", repr(text), "correct it") from None
    return MetricGrid.for_matrix(H, shape, anchor, side)


def wide(
    shape: tuple[int, int], anchor: tuple[float, float] | None, H: PSFMatrix, margin: int
) -> tuple[tuple[int, int], tuple[float, float] | None]:
    """Return shape and anchor of frames with ``margin`` pixels around; an anchor of None is H's own."""
    if not margin:
        return shape, anchor
    row, column = H.anchor if anchor is None else anchor
    return (shape[0] + 2 * margin, shape[1] + 2 * margin), (row + margin, column + margin)


def view_for(
    H: PSFMatrix,
    shape: tuple[int, int],
    white: Path | None,
    lattice: Path | None,
    *,
    resample: bool | None,
    placed: bool,
) -> Resampling | None:
    """Return the map of frames of ``shape`` onto H's period, None: they are used as they are.

    ``resample`` None: where the lattice drifts by more than `MOST_DRIFT` over the frame, as far as lfcal knows it.
    ``placed``: the frames' place against H is given otherwise, so that they cannot be moved.
    """
    from lfcal.cli._console import report
    from lfcal.reconstruct import MOST_DRIFT, drift_words

    if resample or lattice is not None:
        return view_of(H, white, lattice)
    view = known_view(H, shape, white)
    if view is None or view.drift(shape) <= MOST_DRIFT:
        return None
    words = drift_words(view, shape)
    if resample is None and not placed:
        report(f"note: {words}; frames are resampled to it (--as-is uses them as they are)")
        return view
    remedy = "frames that are placed by --anchor, --region or a session are not resampled" if placed else ""
    report(f"warning: {words}, and volumes show ghosts; {remedy or 'leave --as-is out to resample frames'}")
    return None


def known_view(
    H: PSFMatrix, shape: tuple[int, int], white: Path | None, lattice: Path | None = None, *, quiet: bool = False
) -> Resampling | None:
    """Return the map by a measured lattice, that of the white frame, or else that of H's camera; None: unknown."""
    from lfcal.base import InputError
    from lfcal.cli._console import report
    from lfcal.reconstruct import Resampling, lattice_anchor_of

    if lattice is not None:
        return view_of(H, white, lattice)
    if white is not None:
        try:
            return view_of(H, white)
        except InputError as error:
            if not quiet:
                report(f"note: no lattice is measured in the white image; {error}")
    if H.camera is None or shape != H.camera.sensor.shape:
        return None
    return Resampling.of_camera(H.camera, H.period, lattice_anchor_of(H))


def anchor_of(text: str, view: Resampling | None, H: Any) -> tuple[float, float] | None:
    """Return the pixel of H's position (0, 0): as given, where resampling puts it, or None for H's own."""
    from lfcal.base import InputError
    from lfcal.reconstruct import lattice_anchor_of

    if not text:
        return None if view is None else view.anchor(lattice_anchor_of(H))
    try:
        row, column = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError.expected("--anchor", "ROW,COLUMN", text, "for example 12,7") from None
    return row, column


def check_as_is(lattice: Path | None, *, resample: bool, as_is: bool) -> bool | None:
    """Return whether to resample frames; None: where they need it. Refuse options that exclude each other."""
    from lfcal.base import InputError

    if as_is and (resample or lattice is not None):
        other = "--resample" if resample else "--lattice"
        raise InputError.expected("--as-is", f"no {other}, which resamples frames", other, "leave one of them out")
    return False if as_is else resample or None


def view_of(H: Any, white: Path | None, lattice: Path | None = None) -> Resampling:
    """Return the map of frames onto H's period, by a measured lattice, the white frame's or H's camera's."""
    from lfcal.base import InputError
    from lfcal.frames.corrections import read_average
    from lfcal.reconstruct import Resampling, lattice_anchor_of

    if lattice is not None:
        from lfcal.tasks import load_lattice

        fit = load_lattice(lattice)
        kind = fit.kind if H.camera is None else H.camera.lattice.kind
        if fit.kind != kind:
            raise InputError.expected(str(lattice), f"the {kind} lattice of H", fit.kind, "use its own camera's")
    elif white is None and H.camera is not None:
        return Resampling.of_camera(H.camera, H.period, lattice_anchor_of(H))
    elif white is None:
        raise InputError.expected(
            "--resample", "a white frame, a lattice, or a camera with H", "none", "give --white or --lattice"
        )
    else:
        from lfcal.lattice import fit_lattice

        fit = fit_lattice(read_average(white), kind=None if H.camera is None else H.camera.lattice.kind)
    if H.camera is None or len(H.camera.lattice.types) == 1:
        return Resampling.of_fit(fit, H.period, lattice_anchor_of(H))
    measured = _measured(H.camera, fit, None if white is None else read_average(white))
    return Resampling.of_camera(measured, H.period, lattice_anchor_of(H))


def _measured(camera: Camera, fit: LatticeFit, white: NDArray[np.float32] | None) -> Camera:
    """Return ``camera`` of three lens types with the lattice of ``fit``: a lenslet of type 0 is at its offset.

    Which one that is the white frame tells; without it, or where it does not, the nearest to the offset stated.
    """
    from lfcal.base import InputError
    from lfcal.cli._console import report
    from lfcal.lattice import classify_lens_types, expected_blur

    lattice = fit.to_lattice(camera)
    if white is not None:
        try:
            lattice = classify_lens_types(white, fit, expected_blur(camera)).to_lattice(fit, camera)
        except InputError as error:
            report(f"note: lens types are taken as H's camera states them; {error}")
    return replace(camera, lattice=lattice)
