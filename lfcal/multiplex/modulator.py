"""Plenoptic modulators as separable bases, which define the measurement of each pixel of a super-pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, array_words, check_number, check_tuple, format_pixels

__all__ = ["Modulator", "default_rcond", "modulator_from_matrix"]

Array = NDArray[np.float64]
Basis = NDArray[Any]

MAX_SAMPLES = 4096
"""Largest number of plenoptic samples, and of pixels of a super-pixel."""


def default_rcond(shape: tuple[int, int]) -> float:
    """Return the default cut-off for singular values of a matrix of ``shape``, as a fraction of the largest one."""
    return max(shape) * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Modulator:
    """A plenoptic modulator m(x, p) = sum_j sigma_j(x) pi_j(p) (Ihrke et al., eq. 2).

    It defines the fraction m of the plenoptic sample p (a view, a colour, or both) that a pixel at x measures. Samples
    are ordered by view (in row-major order), and within a view by colour. The unmodulated light at a pixel is 1,
    distributed over the N samples as in `light`. If a pixel measures a sample completely, its entry in `matrix` is 1. A
    lenslet concentrates the light of its entire cell on one pixel for each view. The entry of this pixel is the number
    of pixels in the cell.

    Attributes
    ----------
    name
        Name in tables and plots.
    side
        Size ``(rows, columns)`` of the super-pixel (px); its K = rows * columns pixels are in row-major order.
    spatial
        Matrix Sigma, ``(K, J)``: each column is a spatial basis function sigma_j, periodic with the super-pixel.
    plenoptic
        Matrix Pi, ``(N, J)``: each column is a plenoptic basis function pi_j over the N samples.
    views
        Number of views ``(rows, columns)``; the super-pixel separates as many directions.
    colours
        Names of the samples within each view: colours, spectral bands, Stokes parameters, moments in time, or products
        of these; empty for a monochrome light field.
    cell
        Size ``(rows, columns)`` of a cell, the super-pixel of the light field alone (px); (1, 1) for a colour filter
        array.
    lenslets
        Whether all pixels of a cell sample the light at the position of their lenslet instead of at their own
        positions.
    light
        Samples of unmodulated light, ``(N,)``, which a pixel without a modulator records as 1. None: 1/N each.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import Modulator, mask
    >>> places = np.array([[1, 0], [0, 1], [0, 1], [1, 0]])  # magenta and green filters as on a chessboard
    >>> filters = np.array([[1, 0], [0, 1], [1, 0]])  # of red, green, blue through each
    >>> own = Modulator("chessboard", (2, 2), places, filters, colours=("R", "G", "B"))
    >>> print(own.matrix[0], "rank", own.rank(), "of", own.count, "lost", own.lost().round(2))
    [1 0 1] rank 2 of 3 lost [0.5 0.  0.5]
    >>> print((mask("lenslet", 3) * own).side)  # lenslets in front of it
    (6, 6)
    """

    name: str
    side: tuple[int, int]
    spatial: Basis = field(repr=False)
    plenoptic: Basis = field(repr=False)
    views: tuple[int, int] = (1, 1)
    colours: tuple[str, ...] = ()
    cell: tuple[int, int] = (1, 1)
    lenslets: bool = False
    light: Array = field(default=None, repr=False)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        """Check that the parts fit together."""
        for what in ("side", "views", "cell"):
            value = check_tuple(f"{what} of {self.name}", getattr(self, what), 2, at_least=1, integer=True)
            object.__setattr__(self, what, value)
        if any(s % c for s, c in zip(self.side, self.cell, strict=True)):
            raise InputError.expected(
                f"cell of {self.name}",
                f"a divisor of {self.side}",
                self.cell,
                "choose 1, or another divisor of the side",
            )
        for what, rows in (("spatial", math.prod(self.side)), ("plenoptic", self.count)):
            array = np.array(getattr(self, what))
            wanted = (rows, np.shape(self.spatial)[-1])
            if array.shape != wanted or not np.isfinite(array).all():
                got = array.shape if array.shape != wanted else "NaN or infinity"
                raise InputError.expected(
                    f"{what} basis of {self.name}", f"finite values of shape {wanted}", got, "correct the array"
                )
            array.setflags(write=False)
            object.__setattr__(self, what, array)
        self._take_light()

    def _take_light(self) -> None:
        even = np.full(self.count, 1.0 / self.count)
        light = even if self.light is None else np.array(self.light, float)
        if light.shape != (self.count,) or not np.isfinite(light).all() or not light.any():
            wanted = f"{self.count} finite values, not all zero"
            raise InputError.expected(
                f"unmodulated light of {self.name}",
                wanted,
                array_words(light),
                "give one value per sample",
            )
        light.setflags(write=False)
        object.__setattr__(self, "light", light)

    @property
    def count(self) -> int:
        """Number N of plenoptic samples: views times colours."""
        return math.prod(self.views) * max(1, len(self.colours))

    @property
    def pixels(self) -> int:
        """Number K of pixels in a super-pixel."""
        return math.prod(self.side)

    @property
    def sample_names(self) -> tuple[str, ...]:
        """Name of each of the N samples, such as ``"G"`` or ``"view 3,5 G"``."""
        if self.views == (1, 1):
            return self.colours or ("light",)
        colours = [f" {c}" for c in self.colours] or [""]
        return tuple(f"view {v},{u}{c}" for v in range(self.views[0]) for u in range(self.views[1]) for c in colours)

    @property
    def natural_samples(self) -> tuple[int, int]:
        """Default number (down, across) of output samples in a super-pixel: one for each `cell`."""
        return self.side[0] // self.cell[0], self.side[1] // self.cell[1]

    @property
    def positions(self) -> tuple[Array, Array]:
        """Row and column positions at which the pixels of a super-pixel sample the light (px from the first pixel).

        The arrays have the shapes ``(rows,)`` and ``(columns,)``.
        """
        rows, columns = (
            np.asarray(np.arange(n) // c * c + (c - 1) / 2 if self.lenslets else np.arange(n), float)
            for n, c in zip(self.side, self.cell, strict=True)
        )
        return rows, columns

    @cached_property
    def matrix(self) -> Array:
        """Matrix A = Sigma Pi^T, ``(K, N)``, which maps samples to pixels of a super-pixel (Ihrke et al., eq. 4)."""
        product = self.spatial @ self.plenoptic.T
        if np.iscomplexobj(product):
            worst = float(np.abs(product.imag).max(initial=0.0))
            # complex bases (Fourier) must have a real product; an imaginary part above rounding is an error of the
            # bases
            if worst > 1e-9 * max(1.0, float(np.abs(product).max(initial=0.0))):
                raise InputError.expected(
                    f"transmission of {self.name}",
                    "real values",
                    f"imaginary parts of up to {worst:.1e}",
                    "correct the bases",
                )
        return np.ascontiguousarray(product.real)

    @cached_property
    def _decomposition(self) -> tuple[Basis, Array, Basis]:
        """Singular value decomposition of `matrix`, largest value first; the bases themselves if orthogonal."""
        # columns of orthogonal bases are already the singular vectors, so no decomposition is needed
        if not (_orthogonal(self.spatial) and _orthogonal(self.plenoptic)):
            left, values, right = np.linalg.svd(self.matrix, full_matrices=False)
            return left, values, right
        norms = [np.linalg.norm(basis, axis=0) for basis in (self.spatial, self.plenoptic)]
        # stable, so that equal singular values keep the order of their bases
        order = np.argsort(-norms[0] * norms[1], kind="stable")
        unit = [basis / np.where(n > 0, n, 1.0) for basis, n in zip((self.spatial, self.plenoptic), norms, strict=True)]
        return unit[0][:, order], (norms[0] * norms[1])[order], unit[1].T[order]

    @property
    def singular_values(self) -> Array:
        """Singular values of `matrix` in descending order."""
        return self._decomposition[1]

    def _kept(self, rcond: float | None) -> NDArray[np.bool_]:
        values = self.singular_values
        cut = default_rcond(self.matrix.shape) if rcond is None else rcond
        check_number("cut-off of the pseudo-inverse", cut, at_least=0, below=1)
        kept: NDArray[np.bool_] = (values > cut * values[0]) & (values > 0)
        return kept

    def rank(self, rcond: float | None = None) -> int:
        """Return the rank of `matrix`, the number of independent measurements; ``rcond`` is as in `inverse`."""
        return int(self._kept(rcond).sum())

    @property
    def condition(self) -> float:
        """Condition number of `matrix`; infinite if some samples cannot be recovered."""
        values = self.singular_values
        return float(values[0] / values[-1]) if self.rank() == self.count else math.inf

    def inverse(self, rcond: float | None = None) -> Array:
        """Return the pseudo-inverse of `matrix`, ``(N, K)``, which maps pixels to samples by least squares.

        Parameters
        ----------
        rcond
            Singular values up to this fraction of the largest one count as zero. None: `default_rcond`.
        """
        left, values, right = self._decomposition
        kept = self._kept(rcond)
        product = (right[kept].conj().T / values[kept]) @ left[:, kept].conj().T
        result: Array = np.ascontiguousarray(product.real)
        result[np.abs(result) < 1e-14 * np.abs(result).max(initial=0.0)] = 0.0  # rounding; zeros are skipped later
        return result

    def lost(self, rcond: float | None = None) -> Array:
        """Return the unrecoverable fraction of each sample, ``(N,)``, 0 to 1; ``rcond`` is as in `inverse`.

        It is 1 minus the diagonal of A^+ A, with the pseudo-inverse A^+ of the matrix A.
        """
        right = self._decomposition[2][self._kept(rcond)]
        share: Array = np.clip(1.0 - (np.abs(right) ** 2).sum(0), 0.0, 1.0)
        share[share < 1e-12] = 0.0
        return share

    def spectrum(self) -> NDArray[np.complex128]:
        """Return the discrete Fourier transform of the spatial basis functions, ``(K, J)`` (Ihrke et al., eq. 8)."""
        block = np.asarray(self.spatial).reshape(*self.side, -1)
        spectrum: NDArray[np.complex128] = np.fft.fft2(block, axes=(0, 1)).reshape(self.pixels, -1)
        return spectrum

    def pattern(self) -> Array:
        """Return the transmission of a super-pixel for the middle view, ``(rows, columns, colours)``, as a copy."""
        middle = (self.views[0] // 2) * self.views[1] + self.views[1] // 2
        colours = max(1, len(self.colours))
        block = self.matrix[:, middle * colours : (middle + 1) * colours]
        return block.reshape(*self.side, colours).copy()

    def pattern_spectrum(self) -> Array:
        """Return the magnitude of the Fourier transform of `pattern`, divided by the number of pixels K.

        The array ``(rows, columns, colours)`` has the zero frequency in the middle.
        """
        spectrum = np.fft.fftshift(np.fft.fft2(self.pattern(), axes=(0, 1)), axes=(0, 1))
        result: Array = np.abs(spectrum) / self.pixels
        return result

    def shifted(self, rows: int, columns: int) -> Modulator:
        """Return a copy whose pattern is shifted cyclically by ``rows`` px down and ``columns`` px to the right.

        Raises
        ------
        InputError
            If the modulator has lenslets and the shift is not a whole number of cells.
        """
        if self.lenslets and (rows % self.cell[0] or columns % self.cell[1]):
            raise InputError.expected(
                f"shift of {self.name}",
                f"a shift by whole lenslets of {format_pixels(self.cell)}",
                (rows, columns),
                "crop the frame at the edges of lenslets",
            )
        block = np.asarray(self.spatial).reshape(*self.side, -1)
        return replace(self, spatial=np.roll(block, (rows, columns), (0, 1)).reshape(self.pixels, -1))

    def __mul__(self, other: Modulator) -> Modulator:
        """Return this modulator in front of ``other``: light passes both, such as lenslets and a Bayer sensor.

        The sides of the super-pixel are the least common multiples of both. Basis functions and samples of the product
        are those of all pairs. Two modulators that separate the same kind of sample (two masks, two colour filter
        arrays) have no product.
        """
        if not isinstance(other, Modulator):
            return NotImplemented
        return _product(self, other)


def _orthogonal(basis: Basis) -> bool:
    gram = np.abs(basis.conj().T @ basis)
    length = gram.diagonal().copy()
    np.fill_diagonal(gram, 0.0)
    return bool(gram.max(initial=0.0) <= 1e-12 * length.max(initial=0.0))


def _product(one: Modulator, two: Modulator) -> Modulator:
    side = (math.lcm(one.side[0], two.side[0]), math.lcm(one.side[1], two.side[1]))
    _check_factors(one, two, max(math.prod(side), one.count * two.count))
    # product of two transmission patterns: multiply every pair of basis functions
    spatial = (_tiled(one, side)[:, :, None] * _tiled(two, side)[:, None, :]).reshape(math.prod(side), -1)
    order = _order(one, two)
    return Modulator(
        f"{one.name} x {two.name}",
        side,
        spatial,
        np.kron(one.plenoptic, two.plenoptic)[order],
        (one.views[0] * two.views[0], one.views[1] * two.views[1]),
        _names(one.colours, two.colours),
        (math.lcm(one.cell[0], two.cell[0]), math.lcm(one.cell[1], two.cell[1])),
        one.lenslets or two.lenslets,
        np.asarray(np.kron(one.light, two.light)[order], float),
    )


def _check_factors(one: Modulator, two: Modulator, entries: int) -> None:
    if _kinds(one) & _kinds(two):
        raise InputError.expected(
            "product of modulators",
            "samples of different kinds (views, colours, moments, polarisation)",
            f"{one.name} and {two.name}",
            "combine a mask or lenslets with a colour filter array",
        )
    if entries > MAX_SAMPLES:
        raise InputError.expected(
            "super-pixel of the product",
            f"at most {MAX_SAMPLES:,} entries (pixels times samples)",
            f"{entries:,}",
            "choose smaller factors",
        )


def _kinds(factor: Modulator) -> set[str]:
    """Return which kinds of sample a factor separates; colours and bands of a spectrum are one kind."""
    words = {word for name in factor.colours for word in name.split(" ")}
    views = set() if factor.views == (1, 1) else {"view"}
    return views | {"colour" if word in ("R", "G", "B", "nm") else word for word in words if not word.isdigit()}


def _tiled(factor: Modulator, side: tuple[int, int]) -> Basis:
    """Return the spatial basis repeated over a larger super-pixel."""
    r, c = np.divmod(np.arange(math.prod(side)), side[1])
    rows: Basis = factor.spatial[(r % factor.side[0]) * factor.side[1] + c % factor.side[1]]
    return rows


def _order(one: Modulator, two: Modulator) -> NDArray[np.intp]:
    """Return the order of the pairs of samples in which they are sorted by view, then by colour."""
    (av, au), (bv, bu) = one.views, two.views
    shape = (av, au, max(1, len(one.colours)), bv, bu, max(1, len(two.colours)))
    return np.arange(math.prod(shape)).reshape(shape).transpose(0, 3, 1, 4, 2, 5).ravel()


def _names(one: tuple[str, ...], two: tuple[str, ...]) -> tuple[str, ...]:
    if not one or not two:
        return one or two
    return tuple(f"{a} {b}" for a in one for b in two)


def modulator_from_matrix(
    name: str,
    side: tuple[int, int],
    matrix: Array,
    *,
    views: tuple[int, int] = (1, 1),
    colours: tuple[str, ...] = (),
    cell: tuple[int, int] = (1, 1),
    lenslets: bool = False,
    light: ArrayLike | None = None,
) -> Modulator:
    """Return the modulator with the given matrix A of transmissions, ``(K, N)``: Sigma = A, Pi = identity.

    The K rows are the pixels of the super-pixel in row-major order, the N columns its samples. The other parameters are
    those of `Modulator`.

    Examples
    --------
    >>> from lfcal.multiplex import modulator_from_matrix
    >>> own = modulator_from_matrix("clear, red", (1, 2), [[1, 1], [1, 0]], colours=("R", "B"))
    >>> print(own.inverse().round(3))  # blue is the clear pixel minus the red one
    [[ 0.  1.]
     [ 1. -1.]]
    """
    array = np.asarray(matrix, float)
    if array.ndim != 2:
        raise InputError.expected(
            f"transmissions of {name}", "a matrix of shape (K, N)", array.shape, "give one row per pixel"
        )
    samples: Any = None if light is None else np.asarray(light, float)
    return Modulator(name, side, array, np.eye(array.shape[1]), views, colours, cell, lenslets, samples)
