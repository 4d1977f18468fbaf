"""Traces of lossy compression: steps between blocks, and lost fine structure within them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import dctn

from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FaultPicture, FoundFault
from lfcal.judge.faults._series import SURE

__all__ = ["FAULTS", "Compression"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

BLOCK = 8
"""Number of pixels along a block of the usual codecs."""

DARK = 0.005
"""Fraction of the brightest light above which neighbours are not compared."""

SPIKE = 4.0
"""Multiple of the mean difference of neighbours at which differences are limited."""

STEPS = 1.1
"""Ratio of differences across blocks to those within blocks that is reported."""

OTHERS = (5, 6, 7, 9, 10, 11)
"""Periods (pixels) that no codec has, but with which the structure of lenslets repeats as well as with the period of
blocks."""

CLEARLY = 2.0
"""Factor by which the difference across blocks must exceed the difference at each period of `OTHERS`."""

LIT = 0.02
"""Fraction of the brightest light that a block needs for its finest structure to be informative."""

SMALL = 0.3
"""Multiple of the typical size of a fine-structure coefficient below which it counts as lost."""

GONE = 0.15
"""Smallest fraction of lost structure in the blocks of a codec, in excess of that in shifted blocks."""

FEW = 500
"""Number of coefficients needed for each offset of the blocks."""

WINDOWS = 60_000
"""Largest number of blocks that are examined."""

BESIDE = tuple((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x)


class Compression(Fault):
    """Block edges or missing fine structure, caused by lossy compression."""

    name = "compression"
    needs_camera = False
    rank = 7
    title = "lossy compression"
    subject = "file"
    advice = "Record without lossy compression. The lost details cannot be recovered."
    settles: ClassVar[tuple[str, ...]] = (
        "jitter",
        "flicker",
        "snr",
        "background",
        "stage_gain",
        "depth",
        "lamp",
        "misplaced",
        "drift",
        "pitch",
    )
    explains: ClassVar[tuple[str, ...]] = ("not_linear", "bad_pixels", "jitter", "flicker")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if samples differ more across block edges than within blocks, or if fine structure is missing.

        Nothing is yielded if all frames were stored without loss, or were computed.
        """
        if evidence.computed or _lossless(evidence.matrix.provenance):
            return
        left = evidence.left
        # where there is light, lost detail is larger than the steps of blocks
        dark = evidence.valid & (evidence.light < DARK * float(evidence.light.max()))
        most_of = SPIKE * float(np.abs(np.diff(left, axis=2)).mean())  # a single pixel is not a sign of blocks
        for what, corners in (("sensor", evidence.corners()), ("cutout", np.zeros((len(left), 2), np.intp))):
            found = [_borders(left, dark, corners[:, axis], axis, most_of) for axis in (0, 1)]
            ratios, sigmas = ([one[k] for one in found] for k in (0, 1))
            # lines with different offsets differ everywhere, and by chance at the edges of blocks
            if min(ratios) < STEPS or min(sigmas) < SURE or min(one[2] for one in found) < STEPS:
                continue
            # the residual of a model for small lenslets also differs, with its own period
            others = (
                min(_borders(left, dark, corners[:, axis], axis, most_of, other)[0] for axis in (0, 1))
                for other in OTHERS
            )
            if min(ratios) - 1 > CLEARLY * (max(others) - 1):
                yield FoundFault(
                    self,
                    f"neighbours across blocks of {BLOCK} x {BLOCK} pixels of the {what} differ "
                    f"{min(ratios):.2f} times as much as within blocks",
                    float(min(sigmas)),
                    float(np.sqrt(np.square(left).mean()) / max(float(np.abs(evidence.light).mean()), 1e-300)),
                    put_in=lambda patch: patch.recorded,
                )
                return
        yield from self._rounded(evidence)

    def _rounded(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if blocks at one offset have lost more fine structure than blocks shifted by one pixel."""
        for what, corners in (("sensor", evidence.corners()), ("cutout", np.zeros((len(evidence), 2), np.intp))):
            gone, counts = _gone(evidence, corners)
            if counts.min() < FEW:
                continue
            shifted = np.mean([np.roll(gone, by, (0, 1)) for by in BESIDE], axis=0)
            more = gone - shifted
            k = np.unravel_index(int(np.argmax(more)), more.shape)
            reported = float(more[k] / np.sqrt(shifted[k] * (1 - shifted[k]) / counts[k] * (1 + 1 / len(BESIDE))))
            if more[k] < GONE or reported < SURE:
                continue
            yield FoundFault(
                self,
                f"{100 * gone[k]:.0f} % of the finest structure in blocks of {BLOCK} x {BLOCK} pixels of the {what} "
                f"is lost, and {100 * shifted[k]:.0f} % in shifted blocks",
                reported,
                float(np.sqrt(np.square(evidence.left).mean()) / max(float(np.abs(evidence.light).mean()), 1e-300)),
                picture=FaultPicture(
                    100 * gone,
                    "%",
                    "lost fraction of the finest structure, by the position of the blocks",
                    ("row (px)", "column (px)"),
                ),
                put_in=lambda patch: patch.recorded,
            )
            return


def _lossless(provenance: Mapping[str, Any]) -> bool:
    """Return whether the provenance of H states that every frame was stored without loss."""
    # from a file that anyone may have written
    frames = provenance.get("frames")
    codec = frames.get("codec") if isinstance(frames, Mapping) else None
    return isinstance(codec, Mapping) and codec.get("lossless") is True


def _borders(
    left: F4, dark: NDArray[np.bool_], first: NDArray[np.intp], axis: int, most_of: float, block: int = BLOCK
) -> tuple[float, float, float]:
    """Return the excess of differences between neighbours at possible edges of blocks.

    Parameters
    ----------
    left, dark
        Residuals of patterns ``(n, nt, ns)``, and the entries with hardly any light.
    first
        Line of each pattern's first sample ``(n,)``.
    axis
        0: from row to row, 1: from column to column.
    most_of
        Magnitude at which differences are limited.
    block
        Size of a block (pixels).

    Returns
    -------
    The result is a ratio, its significance in standard deviations, and the ratio after removing differences of whole
    lines.
    """
    steps = np.clip(np.diff(left, axis=1 + axis), -most_of, most_of)
    both = dark[:, 1:] & dark[:, :-1] if axis == 0 else dark[:, :, 1:] & dark[:, :, :-1]
    lines = first[:, None] + np.arange(steps.shape[1 + axis])
    counts = np.bincount(lines.ravel(), both.sum(2 - axis).ravel())
    common = np.bincount(lines.ravel(), np.where(both, steps, 0).sum(2 - axis).ravel()) / np.maximum(counts, 1)
    shared = common[lines][:, :, None] if axis == 0 else common[lines][:, None]
    reported = []
    for some in (steps, steps - shared):
        sums = np.where(both, np.abs(some), 0).sum(2 - axis)
        many = np.bincount(lines.ravel() % block, both.sum(2 - axis).ravel(), block)
        each = np.bincount(lines.ravel() % block, sums.ravel(), block) / np.maximum(many, 1)
        most = int(np.argmax(each))
        reported.append(float(each[most] / max(float(np.delete(each, most).mean()), 1e-300)))
    # the mean of this number of magnitudes scatters by 0.75 over its square root; lost detail exceeds this
    return reported[0], (reported[0] - 1) * float(np.sqrt(max(float(many.min()), 1.0))) / 2.0, reported[1]


def _gone(evidence: Evidence, corners: NDArray[np.intp]) -> tuple[F8, F8]:
    """Return the fraction of almost zero fine-structure coefficients, and the number of all, by offset of blocks."""
    gone, counts = np.zeros((BLOCK, BLOCK)), np.zeros((BLOCK, BLOCK))
    data = np.where(evidence.valid, evidence.data, np.float32(0))
    nt, ns = (n - BLOCK + 1 for n in data.shape[1:])
    if min(nt, ns) < 2 * BLOCK:
        return gone, counts
    some = np.linspace(0, len(data) - 1, max(1, min(len(data), WINDOWS // (nt * ns)))).astype(int)
    u = np.arange(BLOCK)
    fine = (u[:, None] + u) > BLOCK
    bright = LIT * float(data.max())
    each = []
    for k in some.tolist():
        windows = sliding_window_view(data[k], (BLOCK, BLOCK))
        lit = windows.max((2, 3)) > bright
        if lit.any():
            y, x = np.nonzero(lit)
            sizes = np.abs(dctn(windows[y, x], axes=(1, 2), norm="ortho"))[:, fine]
            each.append(((y + corners[k, 0]) % BLOCK, (x + corners[k, 1]) % BLOCK, sizes))
    if not each:
        return gone, counts
    small = SMALL * float(np.median(np.concatenate([sizes.ravel() for _, _, sizes in each])))
    for y, x, sizes in each:
        np.add.at(gone, (y, x), (sizes < small).sum(1))
        np.add.at(counts, (y, x), sizes.shape[1])
    return gone / np.maximum(counts, 1), counts


FAULTS = (Compression(),)
