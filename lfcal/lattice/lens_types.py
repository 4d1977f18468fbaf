"""The type of each lenslet, from the sharpness of its micro-image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, as_sensor_frame, check_choice, check_tuple, format_pixels
from lfcal.camera import Camera, LensletLattice
from lfcal.lattice._micro_image import light_of
from lfcal.lattice._rounds import levelled
from lfcal.lattice.fit import LatticeFit

__all__ = ["LensTypes", "classify_lens_types", "expected_blur"]

Array = NDArray[np.float64]
MIN_TRIANGLES = 8
MIN_SIGMAS = 4.0
MIN_AGREEMENT = 0.5
MIN_BLUR_STEP = 0.05
"""Types whose expected blurs differ by less than this fraction of the largest are not distinguished."""

SMOOTHING = 0.04
"""Blur applied before gradients are computed (pitches)."""

INNER = 0.4
"""Radius of a micro-image's inner part (pitches)."""

LIT_SHARE = 0.1
"""Smallest light of a lit lenslet, as a fraction of the brightest lenslets' light."""


@dataclass(frozen=True, slots=True)
class LensTypes:
    """Assignment of three lens types to the lenslets of a hexagonal lattice.

    Attributes
    ----------
    type_step
        Type of the lenslet that follows a type-0 lenslet along a row: 1 or 2.
    phase
        Value of ``(q - r) mod 3`` for the lenslets of type 0, with the indices (q, r) of the lattice fit.
    sharpness
        Mean, for types 0, 1 and 2, of the logarithm of the sharpness minus its mean over the triangle. Sharpness is the
        light in the inner part of the micro-image (white image), or the gradient energy divided by the squared light
        (spots).
    agreement
        Fraction of the triangles of adjacent lenslets that individually favour this assignment; 1/6 by chance.
    sigmas
        Margin of this assignment over the second-best one, in standard errors.
    triangles
        Number of triangles of adjacent lenslets that were used.
    """

    type_step: int
    phase: int
    sharpness: tuple[float, float, float]
    agreement: float
    sigmas: float
    triangles: int

    @property
    def confidence(self) -> float:
        """Probability that this assignment is correct, derived only from its margin; at most 1 - 1e-6."""
        return min(0.5 * math.erfc(-self.sigmas / math.sqrt(2)), 1 - 1e-6)

    def type_of(self, q: ArrayLike, r: ArrayLike) -> NDArray[np.intp]:
        """Return the types (0, 1 or 2) of the lenslets with the indices q and r of the lattice fit."""
        coset = np.asarray(q, np.intp) - np.asarray(r, np.intp)
        return np.mod(self.type_step * (coset - self.phase), 3)

    def to_lattice(self, fit: LatticeFit, camera: Camera) -> LensletLattice:
        """Return a copy of the lattice of ``camera`` with the values of ``fit`` and this order of the lens types.

        The offset is the position of the lenslet of type 0 nearest to the current offset.
        """
        row, column = camera.pixels(camera.lattice.offset_um)
        near = np.rint(fit.lenslet_at(row, column)).astype(int)
        # the nearest lenslet of type 0 is at most two steps away
        steps = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3)]) + near
        zero = steps[self.type_of(steps[:, 0], steps[:, 1]) == 0]
        distance = np.hypot(*(fit.centres_px(zero[:, 0], zero[:, 1]) - (row, column)).T)
        q, r = zero[int(np.argmin(distance))]
        return fit.to_lattice(camera, origin=(int(q), int(r)), type_step=self.type_step)


def expected_blur(camera: Camera, virtual_depth: float | None = None) -> tuple[float, ...]:
    """Return the blur diameter of each lens type, ``|1/vf - 1/v|``, in lenslet diameters.

    Here v is the ``virtual_depth`` of the point source in the frame, and vf the virtual depth at which the lens type is
    in focus. If ``virtual_depth`` is None, the frame is a white image, in which the lenslets image the pupil of the
    main lens. Then v = -b/B, with the image distance b and the gap B. A virtual depth of 0 raises `InputError`.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import expected_blur
    >>> [round(blur, 2) for blur in expected_blur(preset("r29"), virtual_depth=3.0)]
    [0.17, 0.0, 0.13]
    """
    gap = camera.lattice.gap_um
    if virtual_depth is None:
        inverse = -gap / camera.optics.image_distance_um
    elif virtual_depth == 0:
        raise InputError.expected("virtual depth", "a plane away from the lenslets", 0, "choose another frame")
    else:
        inverse = 1 / virtual_depth
    return tuple(abs(1 / kind.focus_depth(gap) - inverse) for kind in camera.lattice.types)


def classify_lens_types(
    image: ArrayLike,
    fit: LatticeFit,
    blur: Sequence[float],
    *,
    content: str = "white",
    dark: ArrayLike | float = 0.0,
    workers: int | None = None,
) -> LensTypes:
    """Determine the lens type of each lenslet of a three-type array, from a white image or a frame of a point source.

    Types alternate such that every triangle of adjacent lenslets contains one lenslet of each type. The sharpness is
    compared within each triangle. This comparison is independent of vignetting and of slow variations of the scene. Of
    the six possible assignments, the function returns the one whose expected blurs are most strongly anticorrelated
    with the measured sharpness. In a white image, sharpness is the light in the inner part of the micro-images. This
    measure requires that all types transmit the same amount of light, as lenslets of equal size do.

    Parameters
    ----------
    image
        Frame ``(rows, columns)``.
    fit
        Lattice fitted to a white image of the same camera.
    blur
        Expected blur of types 0, 1 and 2 in this frame, in any unit, as returned by `expected_blur`.
    content
        ``"white"``: a uniformly lit frame; ``"spots"``: a point source away from the focus of the lenslets.
    dark
        Dark frame, or dark level (counts), to subtract.
    workers
        Number of threads. None: one for each available CPU core.

    Raises
    ------
    InputError
        If the lattice is not hexagonal, or the shape of the frame differs from that of the lattice. Also if two types
        have the same expected blur, or the frame does not determine the assignment.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import Camera
    >>> from lfcal.frames import read_image
    >>> from lfcal.lattice import LensTypes, classify_lens_types, expected_blur, fit_lattice
    >>> camera = Camera.from_json(Path("session/camera.json").read_text(encoding="utf-8"))
    >>> white = read_image("session/white/white_0.png")
    >>> fit = fit_lattice(white, dark=64.0)
    >>> types: LensTypes = classify_lens_types(white, fit, expected_blur(camera), dark=64.0)
    >>> print(types.type_of([0, 1, 2, 3], 0).tolist(), f"{types.agreement:.0%} of the triangles agree")
    [0, 1, 2, 0] 100% of the triangles agree
    """
    check_choice("content of the frame", content, ("white", "spots"))
    expected = _expected(fit, blur)
    frame = as_sensor_frame("frame for lens types", image)
    if frame.shape != fit.shape:
        raise InputError.expected(
            "frame for lens types",
            format_pixels(fit.shape),
            format_pixels(frame.shape),
            "use a frame of the camera of the white image",
        )
    level = np.asarray(dark, np.float32)
    sharpness = _sharpness(levelled((frame - level).astype(np.float32)), fit, content, workers)
    triangles = _triangles(fit.index, sharpness)
    if len(triangles) < MIN_TRIANGLES:
        raise InputError.expected(
            "frame for lens types",
            f"at least {MIN_TRIANGLES} lit triangles of lenslets",
            len(triangles),
            "use a white image or a wider spot",
        )
    return _decide(triangles, expected)


def _expected(fit: LatticeFit, blur: Sequence[float]) -> Array:
    if fit.kind != "hexagonal":
        raise InputError.expected(
            "lattice with three lens types",
            "a hexagonal one",
            f"a {fit.kind} one",
            f"leave the lens types out, because a {fit.kind} lattice has only one",
        )
    expected = np.array(check_tuple("expected blur of the lens types", blur, 3, at_least=0))
    gaps = np.diff(np.sort(expected))
    if gaps.min() < MIN_BLUR_STEP * expected.max():
        got = ", ".join(f"{value:.3g}" for value in expected)
        raise InputError.expected(
            "blur of the three lens types", "values that differ by 5 % or more", got, "use a frame at another depth"
        )
    return expected


def _sharpness(frame: NDArray[np.float32], fit: LatticeFit, content: str, workers: int | None) -> Array:
    """Return the log of a sharpness measure for each lenslet; NaN if dead or dark.

    White image: mean light in the inner part of the micro-image, which blur reduces. Edges are not used, because
    blurred micro-images overlap. Spots: gradient energy divided by squared light. A slight blur beforehand removes
    noise, whose gradients are mainly between neighbouring pixels.
    """
    from lfcal.base import cv2

    centres = fit.centres_px(fit.index[:, 0], fit.index[:, 1])[:, ::-1].copy()
    smooth = cv2.GaussianBlur(frame, (0, 0), SMOOTHING * fit.pitch_px)
    radius = (INNER if content == "white" else 0.5) * fit.pitch_px
    count, light, energy = light_of(smooth, centres, radius, workers).T
    # logarithms turn the common light of the lenslets into an offset that cancels in triangles
    good = ~fit.dead & (light > LIT_SHARE * np.percentile(light, 99)) & (light > 0) & (energy > 0)
    value = np.full(len(centres), np.nan)
    measure = light / np.maximum(count, 1) if content == "white" else energy * count / np.maximum(light, 1e-30) ** 2
    value[good] = np.log(measure[good])
    return value


def _triangles(index: NDArray[np.intp], value: Array) -> Array:
    """Return values ``(n, 3)`` of lenslets (q, r), (q+1, r), (q, r+1) with (q - r) mod 3 = 0, minus their mean.

    The columns are the cosets 0, 1 and 2 of ``(q - r) mod 3``; no lenslet is used twice.
    """
    low = index.min(0)
    size = index.max(0) - low + 2
    grid = np.full(tuple(size), np.nan)
    place = index - low
    grid[place[:, 0], place[:, 1]] = value
    first = place[np.mod(index[:, 0] - index[:, 1], 3) == 0]
    q, r = first.T
    rows = np.stack([grid[q, r], grid[q + 1, r], grid[q, r + 1]], axis=-1)
    # minus their mean: vignetting and slow changes of the scene are equal for three neighbours
    rows = rows[np.isfinite(rows).all(1)]
    centred: Array = rows - rows.mean(1, keepdims=True)
    return centred


def _decide(triangles: Array, expected: Array) -> LensTypes:
    """Choose the assignment of types to cosets with the largest score; scores are linear in the sharpness."""
    wanted = -(expected - expected.mean()) / expected.std()
    choices = list(permutations(range(3)))
    # extreme values are clipped: one dirty lenslet must not dominate the field
    spread = 1.4826 * np.median(np.abs(triangles - np.median(triangles, axis=0))) or 1.0
    scores = np.clip(triangles / spread, -20, 20) @ np.array([wanted[list(types)] for types in choices]).T
    mean = scores.mean(0)
    best, second = np.argsort(-mean)[:2]
    margin = scores[:, best] - scores[:, second]
    sigmas = float(margin.mean() / (margin.std() / math.sqrt(len(margin)) + 1e-12))
    agreement = float((scores.argmax(1) == best).mean())
    types = choices[best]
    phase = types.index(0)
    step = types[(phase + 1) % 3]
    if sigmas < MIN_SIGMAS or agreement < MIN_AGREEMENT:
        got = f"{sigmas:.1f} standard errors, {100 * agreement:.0f} % agreement"
        raise InputError.expected(
            "lens types",
            f"an assignment {MIN_SIGMAS:g} standard errors better than the next, {100 * MIN_AGREEMENT:.0f} % agreement",
            got,
            "use a sharper, brighter or differently focused frame",
        )
    by_type = [float(triangles[:, types.index(k)].mean()) for k in range(3)]
    return LensTypes(step, phase, (by_type[0], by_type[1], by_type[2]), agreement, min(sigmas, 1e6), len(triangles))
