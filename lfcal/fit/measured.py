"""Measured patterns with their positions and noise, and which of them are held out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_number
from lfcal.camera import Camera, ScanPlan
from lfcal.fit.spread import held_out_rows, spread_out
from lfcal.psf import PSFMatrix, copied_positions, optics_of

__all__ = ["QUICK_PATTERN", "Measured", "check_optics", "kept_aside", "measured_of", "of_quick_pattern"]

QUICK_PATTERN = "recorded with the simulator's quick pattern, which has no lenslets"

HELD_OUT = 0.2
"""Fraction of the patterns that is held out for validation."""


MOST_FEW = 3
"""Smallest number of patterns for a fit."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured patterns at known positions, with a model of their noise.

    Attributes
    ----------
    plan
        Plan of the scan, with the camera from which a fit starts; its cutout is that of the patterns.
    index
        Positions (z, y, x) of the n patterns as indices, ``(n, 3)``.
    patterns
        Values of the patterns (counts), ``(n, nt, ns)``; the background may be included.
    noise
        ``(n, 2)``: the variance of a sample of pattern k with the true value v is
        ``noise[k, 0] + noise[k, 1] * max(v, 0)`` (counts²).
    places_px
        Known displacement (rows, columns) of the image of each source from its planned position on the sensor (px),
        ``(n, 2)``.
    valid
        Mask ``(n, nt, ns)``, True at valid samples.
    held_out
        Mask ``(n,)``, True for patterns that are held out to measure the quality of the fit.
    extra_light
        Light at unit gain that each pattern contains in addition to the prediction of the model, ``(n, nt, ns)``. This
        light stays constant while the unknowns change, because computing it for every derivative would take too long.
        None: no additional light.
    blur
        Additional light of each pattern at unit gain, ``(n, nt, ns)``, per µm² of squared hole diameter for the holes
        of a target (`lfcal.fit.setup.Setup.hole_um`). None: the diameter is not fitted.
    blurred_um
        Diameter of the holes whose light ``extra_light`` includes (µm).

    Examples
    --------
    >>> from lfcal.fit import Measured, measured_of
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     measured: Measured = measured_of(H, most=12)
    >>> print(len(measured), "patterns,", int(measured.held_out.sum()), "of them held out")
    12 patterns, 2 of them held out
    """

    plan: ScanPlan
    index: NDArray[np.intp]
    patterns: NDArray[np.float32]
    noise: NDArray[np.float64]
    places_px: NDArray[np.float64]
    valid: NDArray[np.bool_]
    held_out: NDArray[np.bool_]
    extra_light: NDArray[np.float32] | None = None
    blur: NDArray[np.float32] | None = None
    blurred_um: float = 0.0

    def __post_init__(self) -> None:
        """Check the shapes, the positions, the values and the noise."""
        n, cutout = len(self.index), self.sampled
        wanted = {
            "index": (n, 3),
            "patterns": (n, *cutout),
            "noise": (n, 2),
            "places_px": (n, 2),
            "valid": (n, *cutout),
            "held_out": (n,),
        }
        wanted |= {name: (n, *cutout) for name in ("extra_light", "blur") if getattr(self, name) is not None}
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise InputError.expected(
                    name, f"shape {shape}", getattr(self, name).shape, "give one value for each pattern"
                )
        if self.plan.resample:
            raise InputError.expected(
                "patterns",
                "patterns on the original pixels of the sensor",
                "patterns on resampled pixels",
                "assemble them without resampling",
            )
        for plan, own, _ in self.parts():
            _check_inside(self.index[own], plan.shape[:3])
        if not np.isfinite(self.patterns[self.valid]).all():
            raise InputError.expected("patterns", "finite values", "NaN or infinity", "leave these pixels out")
        good = np.isfinite(self.noise).all() and (self.noise >= 0).all() and (self.noise.sum(1) > 0).all()
        if not good:
            got = "an unknown or zero variance"
            raise InputError.expected(
                "noise of the patterns", "a variance above 0", got, "state a constant or a slope above 0 (noise=)"
            )

    def __len__(self) -> int:
        """Return the number of patterns."""
        return len(self.index)

    @property
    def sampled(self) -> tuple[int, ...]:
        """Shape of the samples of a pattern; here, that of the cutout, ``(nt, ns)``."""
        return self.plan.cutout

    def images(self, samples: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the flattened samples of n patterns, ``(n, m)`` with m = nt ns, as cutouts ``(n, nt, ns)``."""
        return samples.reshape(-1, *self.plan.cutout)

    @property
    def level(self) -> NDArray[np.intp]:
        """Index of the gain and the background of each pattern, ``(n,)``; here, the index of its plane."""
        found: NDArray[np.intp] = self.index[:, 0]
        return found

    @property
    def levels(self) -> int:
        """Number of separate gains and backgrounds."""
        return self.plan.shape[0]

    @property
    def plans(self) -> tuple[ScanPlan, ...]:
        """The plan of each region of the field; here, the single plan."""
        return (self.plan,)

    def parts(self) -> Iterator[tuple[ScanPlan, NDArray[np.intp], int]]:
        """Yield (plan, indices of the patterns, index of the region) for each region; here, for a single region."""
        yield self.plan, np.arange(len(self.index)), 0

    def of(self, keep: NDArray[np.bool_]) -> Measured:
        """Return a new object with the patterns that the mask ``keep`` ``(n,)`` selects."""
        return replace(self, **self._some(keep))

    def _some(self, keep: NDArray[np.bool_]) -> dict[str, Any]:
        """Return the attributes of the patterns ``keep``, by name."""
        own = [name for name in ("extra_light", "blur") if getattr(self, name) is not None]
        names = ["index", "patterns", "noise", "places_px", "valid", "held_out", *own]
        return {name: getattr(self, name)[keep] for name in names} | {"blurred_um": self.blurred_um}

    def more_light(self, hole_um: float | None) -> NDArray[np.float32] | None:
        """Return the light ``(n, nt, ns)`` to add to predictions for holes of diameter ``hole_um`` (µm), or None.

        If ``hole_um`` or `blur` is None, the light is that for the diameter `blurred_um`. The result is None if there
        is no additional light.
        """
        if self.extra_light is None or self.blur is None or hole_um is None:
            return self.extra_light
        return self.extra_light + np.float32(hole_um**2 - self.blurred_um**2) * self.blur


def measured_of(
    matrix: PSFMatrix,
    camera: Camera | None = None,
    *,
    positions: Sequence[tuple[int, int, int]] | NDArray[np.intp] | None = None,
    noise: tuple[float, float] | None = None,
    cutout: int | tuple[int, int] | None = None,
    most: int | None = None,
    held_out: float | Sequence[Sequence[int]] = HELD_OUT,
) -> Measured:
    """Return the recorded patterns of H as measured patterns for a fit.

    Parameters
    ----------
    matrix
        H with the recorded patterns.
    camera
        Camera from which the fit starts. None: that of H.
    positions
        Positions (z, y, x) to use. None: all recorded ones, without copied patterns of a half-cell scan.
    noise
        ``(constant, slope)``: the variance of a sample of value v is ``constant + slope * max(v, 0)`` (counts²). None:
        as stated in H.
    cutout
        Rows and columns of the middle part of the cutout to use (odd; px), or one number for both. None: the whole
        cutout.
    most
        Largest number of patterns to use, evenly spread over the positions; ignored if ``positions`` is given. None:
        all.
    held_out
        Fraction of the patterns to hold out, evenly spread over each plane, or the positions (z, y, x) to hold out. If
        none or all of the patterns are at such positions, the default fraction is held out.

    Raises
    ------
    InputError
        If H has no camera, no noise, or too few patterns, or was recorded with the simulator's quick pattern.

    Examples
    --------
    >>> from lfcal.fit import measured_of
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     few = measured_of(H, positions=[(0, 3, 4), (0, 9, 16), (1, 5, 8)], cutout=41)
    >>> print(few.index.tolist(), few.patterns.shape)
    [[0, 3, 4], [0, 9, 16], [1, 5, 8]] (3, 41, 41)
    """
    if matrix.is_transposed:
        raise InputError.expected("patterns", "those of H", "those of HT", "give H")
    check_optics(matrix)
    plan = _plan_of(matrix, camera)
    own = (matrix.recorded > 0) & ~copied_positions(matrix)
    chosen = np.argwhere(own) if positions is None else np.asarray(positions, np.intp).reshape(-1, 3)
    if positions is None and most is not None and len(chosen) > most:
        chosen = chosen[spread_out(chosen, most, plan.period)]
    if len(chosen) < MOST_FEW:
        raise InputError.expected("recorded patterns", f"at least {MOST_FEW}", len(chosen), "record more positions")
    _check_inside(chosen, plan.shape[:3])
    rows, columns = _middle(matrix.cutout, cutout)
    plan = replace(plan, cutout=(rows.stop - rows.start, columns.stop - columns.start))
    patterns = np.stack([np.asarray(matrix[z, y, x], np.float32)[rows, columns] for z, y, x in chosen.tolist()])
    valid = np.stack([matrix.valid(z, y, x)[rows, columns] for z, y, x in chosen.tolist()])
    aside = _aside(chosen, held_out, plan)
    return Measured(plan, chosen, patterns, _noise(matrix, chosen, noise), np.zeros((len(chosen), 2)), valid, aside)


def of_quick_pattern(matrix: PSFMatrix) -> bool:
    """Return whether H states that it was recorded with the simulator's quick pattern."""
    return optics_of(matrix.provenance) == "pattern"


def check_optics(matrix: PSFMatrix) -> None:
    """Raise `InputError` if H was recorded with the simulator's quick pattern."""
    if of_quick_pattern(matrix):
        remedy = "record with the default optics of the simulator, without --option optics=pattern"
        raise InputError.expected("measured patterns", "those of a plenoptic camera", QUICK_PATTERN, remedy)


def kept_aside(matrix: PSFMatrix) -> list[list[int]]:
    """Return the positions (z, y, x) that the provenance of H lists as held out; empty if missing or invalid."""
    said = matrix.provenance.get("kept_aside")
    shape = (matrix.shape[0], *matrix.period)
    # provenance comes from a file that anyone may have written
    good = isinstance(said, list) and all(
        isinstance(p, list)
        and len(p) == 3
        and all(type(v) is int and 0 <= v < n for v, n in zip(p, shape, strict=True))
        for p in said
    )
    return said if good and said else []


def _aside(chosen: NDArray[np.intp], held_out: float | Sequence[Sequence[int]], plan: ScanPlan) -> NDArray[np.bool_]:
    """Return a mask of the ``chosen`` positions that are held out."""
    if isinstance(held_out, Sequence):
        named = np.isin(*(np.ravel_multi_index(tuple(i.T), plan.shape[:3]) for i in (chosen, _index(held_out, plan))))
        if named.any() and not named.all():
            return named
        held_out = HELD_OUT
    check_number("fraction of held-out patterns", held_out, at_least=0, below=0.9)
    aside = np.zeros(len(chosen), np.bool_)
    aside[held_out_rows(chosen, round(held_out * len(chosen)), plan)] = True
    return aside


def _index(positions: Sequence[Sequence[int]], plan: ScanPlan) -> NDArray[np.intp]:
    index = np.asarray(positions, np.intp).reshape(-1, 3)
    _check_inside(index, plan.shape[:3])
    return index


def _check_inside(index: NDArray[np.intp], shape: tuple[int, int, int]) -> None:
    inside = ((index >= 0) & (index < np.array(shape))).all(1)
    if not inside.all():
        first = tuple(int(v) for v in index[~inside][0])
        raise InputError.expected("position (z, y, x)", f"a position inside {shape}", first, "choose another position")


def _plan_of(matrix: PSFMatrix, camera: Camera | None) -> ScanPlan:
    owner = camera or matrix.camera
    if owner is None:
        raise InputError.expected("camera of H", "a description", "none", "state the camera")
    if matrix.pixel_scale != (1.0, 1.0):
        raise InputError.expected(
            "patterns",
            "patterns on the original pixels of the sensor",
            "patterns on resampled pixels",
            "assemble them without resampling",
        )
    if not matrix.knows_depths:
        raise InputError.expected(
            "patterns", "an H that states its depths", "one without", "set the depths of the PSFMatrix"
        )
    depths = tuple(float(z) for z in matrix.depths)
    return ScanPlan(owner, matrix.period, matrix.cutout, depths, matrix.anchor)


def _middle(have: tuple[int, int], want: int | tuple[int, int] | None) -> tuple[slice, slice]:
    wanted = have if want is None else (want, want) if isinstance(want, int) else want
    for size, most in zip(wanted, have, strict=True):
        check_number("cutout (pixels)", size, at_least=3, at_most=most, integer=True)
        if size % 2 == 0:
            raise InputError.expected("cutout (pixels)", "an odd number", size, "add or remove one pixel")
    first, second = (slice((n - w) // 2, (n + w) // 2) for n, w in zip(have, wanted, strict=True))
    return first, second


def _noise(matrix: PSFMatrix, chosen: NDArray[np.intp], given: tuple[float, float] | None) -> NDArray[np.float64]:
    if given is not None:
        for name, value in zip(("constant", "slope"), given, strict=True):
            check_number(f"noise: {name}", value, at_least=0)
        return np.tile(np.asarray(given, np.float64), (len(chosen), 1))
    known = matrix.facts.noise
    if known is None:
        raise InputError.expected("noise of H", "a variance model", "none", "state the constant and the slope (noise=)")
    found: NDArray[np.float64] = known[tuple(chosen.T)].astype(np.float64)
    return found
