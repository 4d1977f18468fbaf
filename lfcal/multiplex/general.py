"""The general route: regularised least squares for any modulator m(x, p), periodic or not, separable or not.

If every pixel has different transmissions, no measurement channel can be interpolated, and super-pixels have no common
decorrelation. The samples are then computed from all pixels together, on a separate grid with linear interpolation
between its nodes. Conjugate gradients minimise sum w (i - sum_n m_n B rho_n)^2 + lambda |grad rho|^2. Each iteration
takes about 7 to 14 multiply-adds per pixel and sample (`GeneralModel.operations`), and usually 20 to 200 iterations
are needed. The routes for super-pixels take one pass.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, InputError, Work, array_words, check_number, check_tuple, drained
from lfcal.multiplex.demultiplexing import check_frame
from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.weighted import measured

__all__ = ["GeneralModel", "GeneralSamples", "demultiplex_generally", "iter_demultiplex_generally", "mask_shadows"]

Array = NDArray[np.float64]

MAX_SHARE = 1e6


class GeneralModel:
    """Linear model of a frame: ``forward`` computes the frame from samples on a grid, ``adjoint`` is the transpose.

    Parameters
    ----------
    transmissions
        Fraction of each sample that each pixel measures, ``(N, rows, columns)``; or a periodic modulator, with
        ``shape``.
    spacing
        Distance between the nodes of the grid (rows, columns) in pixels.
    shape
        Rows and columns of the frame; required for a periodic modulator.
    """

    def __init__(
        self,
        transmissions: ArrayLike | Modulator,
        spacing: tuple[float, float],
        shape: tuple[int, int] | None = None,
    ) -> None:
        self.transmissions = _transmissions(transmissions, shape)
        steps = check_tuple("spacing of the samples (px)", spacing, 2, at_least=0.5)
        self.shape: tuple[int, int] = (self.transmissions.shape[1], self.transmissions.shape[2])
        self.spacing = (steps[0], steps[1])
        self._down, self._across = (_hats(n, s) for n, s in zip(self.shape, steps, strict=True))
        self.grid: tuple[int, int, int] = (len(self.transmissions), self._down.shape[1], self._across.shape[1])

    def forward(self, samples: ArrayLike) -> Array:
        """Return the frame ``(rows, columns)`` that the samples ``(N, nodes down, nodes across)`` produce."""
        values, frame = np.asarray(samples, float).reshape(self.grid), np.zeros(self.shape)
        for share, value in zip(self.transmissions, values, strict=True):
            frame += share * ((self._down @ value) @ self._across.T)
        return frame

    def adjoint(self, frame: ArrayLike) -> Array:
        """Apply the transpose of `forward` to a frame; return an array ``(N, nodes down, nodes across)``."""
        image = np.asarray(frame, float)
        return np.stack([(self._down.T @ (share * image)) @ self._across for share in self.transmissions])

    @property
    def operations(self) -> int:
        """Number of multiply-adds of one iteration, which consists of one `forward` and one `adjoint`."""
        (n, ny, nx), (rows, columns) = self.grid, self.shape
        return int(2 * n * (2 * rows * nx + 2 * rows * columns + rows * columns) + 4 * n * ny * nx)

    @property
    def bytes(self) -> int:
        """Memory of the transmissions and of the solver's six copies of the samples (bytes)."""
        return int(self.transmissions.nbytes + 6 * 8 * np.prod(self.grid))


@dataclass(frozen=True, eq=False)
class GeneralSamples:
    """Result of `demultiplex_generally`, and its cost.

    Attributes
    ----------
    samples
        Samples ``(N, nodes down, nodes across)`` on the grid.
    iterations
        Number of iterations of the conjugate gradients.
    residual
        Weighted rms of the difference between the frame and its prediction, relative to the weighted rms of the frame.
    operations
        Total number of multiply-adds.
    """

    samples: Array = field(repr=False)
    iterations: int
    residual: float
    operations: int


def iter_demultiplex_generally(
    frame: ArrayLike,
    transmissions: ArrayLike | Modulator,
    spacing: float | tuple[float, float],
    *,
    weights: ArrayLike | None = None,
    smoothness: float = 1e-4,
    tolerance: float = 1e-6,
    most: int = 400,
) -> Work[GeneralSamples]:
    """Return `GeneralSamples` of a frame behind any modulator, periodic or not, by regularised least squares.

    Parameters
    ----------
    frame
        Frame ``(rows, columns)`` after background subtraction.
    transmissions
        Fraction of each of the N samples that each pixel measures, ``(N, rows, columns)``; or a modulator, which is
        repeated over the frame.
    spacing
        Distance between the nodes of the grid on which samples are computed (px), one number or (rows, columns). With a
        spacing of about sqrt(N), there are as many pixels as unknowns.
    weights
        Inverse variances of the pixels, ``(rows, columns)``, 0 for saturated and dead pixels. None: all pixels have the
        same weight.
    smoothness
        Weight of the squared differences between adjacent nodes, relative to the mean weight of the measurements. This
        regularisation determines samples that no pixel measures.
    tolerance
        The iterations stop when the norm of the gradient is at most this fraction of its initial value.
    most
        Maximum number of iterations.

    Yields
    ------
    Progress
        Counted in iterations.

    Raises
    ------
    InputError
        If the shape of ``transmissions`` does not match the frame, or an option is out of range.
    """
    pair = spacing if isinstance(spacing, tuple) else (spacing, spacing)
    seen, known = measured(frame, weights)
    image = check_frame(seen, (1, 1)).astype(float)
    model = GeneralModel(transmissions, pair, (image.shape[0], image.shape[1]))
    if model.shape != image.shape:
        raise InputError.expected(
            "transmissions",
            f"shape (N, {image.shape[0]}, {image.shape[1]})",
            model.transmissions.shape,
            "give one transmission per sample and pixel",
        )
    check_number("smoothness", smoothness, at_least=0)
    check_number("iterations", most, at_least=1, integer=True)
    check_number("tolerance", tolerance, above=0, below=1)
    known = known / known.max()
    # relative to the measured fraction of a node, so that a number has the same effect for every modulator
    share = model.adjoint(known * model.forward(np.ones(model.grid))).mean()
    rough = smoothness * float(share)
    right, clock = model.adjoint(known * image), Clock("demultiplex", most)

    def normal(x: Array) -> Array:
        return model.adjoint(known * model.forward(x)) + rough * _roughness(x)

    x, r = np.zeros(model.grid), right
    p, first, now = r, float((right**2).sum()), float((right**2).sum())
    done = 0
    while done < most and now > tolerance**2 * first:
        yield clock.at(done, f"residual {(now / first) ** 0.5:.1e}")
        q = normal(p)
        step = now / float((p * q).sum())
        x, r = x + step * p, r - step * q
        last, now = now, float((r**2).sum())
        p, done = r + now / last * p, done + 1
    yield clock.at(most)
    miss = float((known * (model.forward(x) - image) ** 2).sum() / max(float((known * image**2).sum()), 1e-300))
    return GeneralSamples(x, done, miss**0.5, (done + 2) * model.operations)


demultiplex_generally = drained(
    iter_demultiplex_generally,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import demultiplex_generally
    >>> shares = np.random.default_rng(0).random((2, 24, 24))  # each pixel has its own
    >>> frame = 0.7 * shares[0] + 0.3 * shares[1]
    >>> found = demultiplex_generally(frame, shares, spacing=2)
    >>> print(found.samples.shape, found.samples.mean(axis=(1, 2)).round(3))
    (2, 12, 12) [0.7 0.3]
    """,
)


def mask_shadows(pattern: ArrayLike, shape: tuple[int, int], views: tuple[int, int], shift_px: float) -> Array:
    """Return the transmission of each view through a mask at each pixel of a frame, ``(views, rows, columns)``.

    The mask need not be periodic. The transmission for the view v at the pixel x, relative to the middle view, is
    m(x - s v). Here m is the mask and s the shift (Ihrke et al., eq. 9). Each pixel averages over its area the cells of
    the mask, which are one pixel wide. Outside the pattern, the mask is opaque.

    Parameters
    ----------
    pattern
        Transmission of the cells of the mask, ``(rows, columns)``, 0 to 1. For the middle view, the centre of the
        pattern is projected onto the centre of the frame.
    shape
        Rows and columns of the frame.
    views
        Number of views ``(down, across)``; the first axis of the result is in row-major order.
    shift_px
        Shift s of the shadow from one view to the next (px).

    Examples
    --------
    >>> from lfcal.multiplex import mask_shadows
    >>> hole = [[0, 0, 1, 0, 0]]
    >>> print(mask_shadows(hole, (1, 5), (1, 3), 1.0)[:, 0])  # one pixel further from view to view
    [[0. 1. 0. 0. 0.]
     [0. 0. 1. 0. 0.]
     [0. 0. 0. 1. 0.]]
    >>> print(mask_shadows(hole, (1, 5), (1, 3), 0.5)[:, 0])
    [[0.  0.5 0.5 0.  0. ]
     [0.  0.  1.  0.  0. ]
     [0.  0.  0.5 0.5 0. ]]
    """
    from scipy.ndimage import shift as moved

    values = np.asarray(pattern, float)
    if values.ndim != 2 or not values.size or not (values.min() >= 0 and values.max() <= 1):
        raise InputError.expected(
            "mask",
            "rows and columns of transmissions from 0 to 1",
            array_words(values),
            "give one transmission per pixel of the mask",
        )
    wide = np.zeros([n + 2 * m for n, m in zip(values.shape, shape, strict=True)])
    wide[shape[0] : shape[0] + values.shape[0], shape[1] : shape[1] + values.shape[1]] = values
    found = []
    for v in np.arange(views[0]) - (views[0] - 1) / 2:
        for u in np.arange(views[1]) - (views[1] - 1) / 2:
            # linear between cells is the overlap of a moved cell with a pixel of its size
            seen = moved(wide, (shift_px * v, shift_px * u), order=1, mode="constant")
            top, left = ((n + m) // 2 for n, m in zip(values.shape, shape, strict=True))
            found.append(seen[top : top + shape[0], left : left + shape[1]])
    return np.clip(np.array(found), 0.0, 1.0)


def _transmissions(given: ArrayLike | Modulator, shape: tuple[int, int] | None) -> Array:
    if isinstance(given, Modulator):
        if shape is None:
            raise InputError.expected(
                "shape of the frame",
                "(rows, columns), because a modulator is given",
                "none",
                "pass the shape of the frame",
            )
        if not given.matrix.any():
            raise InputError.expected(
                f"transmissions of {given.name}", "some light", "only zeros", "give transmissions above 0"
            )
        rows, columns = (np.arange(n) % s for n, s in zip(shape, given.side, strict=True))
        return np.ascontiguousarray(given.matrix[rows[:, None] * given.side[1] + columns].transpose(2, 0, 1))
    if np.asarray(given).dtype.kind not in "uifb":
        raise InputError.expected("transmissions", "real numbers", np.asarray(given).dtype, "give real numbers")
    array = np.asarray(given, float)
    if array.ndim != 3 or not array.size:
        raise InputError.expected("transmissions", "shape (N, rows, columns)", array.shape, "give one plane per sample")
    if not np.isfinite(array).all():
        raise InputError.expected("transmissions", "finite numbers", "NaN or infinity", "correct the values")
    if (largest := np.abs(array).max()) > MAX_SHARE:
        raise InputError.expected(
            "transmissions", f"magnitudes up to {MAX_SHARE:g}", f"{largest:g}", "give fractions of the light"
        )
    if not array.any():
        raise InputError.expected("transmissions", "some light", "only zeros", "give transmissions above 0")
    return array


def _roughness(x: Array) -> Array:
    """Return the gradient of half the squared differences between neighbouring nodes, the Laplacian with free ends."""
    found = np.zeros_like(x)
    for axis in (1, 2):
        steps = np.diff(x, axis=axis)
        found -= np.diff(steps, axis=axis, prepend=0.0, append=0.0)
    return found


def _hats(length: int, spacing: float) -> Any:
    """Return the linear interpolation to pixels from nodes that are ``spacing`` pixels apart."""
    from scipy.sparse import csr_array

    count = max(1, round(length / spacing))
    place = np.clip((np.arange(length) + 0.5) / spacing - 0.5, 0, count - 1)
    first = np.minimum(place.astype(int), max(count - 2, 0))
    share = place - first
    rows = np.repeat(np.arange(length), 2)
    columns = np.stack([first, np.minimum(first + 1, count - 1)], 1).ravel()
    return csr_array((np.stack([1 - share, share], 1).ravel(), (rows, columns)), shape=(length, count))
