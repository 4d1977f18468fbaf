"""The transposed matrix HT, one slice of it, and depth-plane sums, for plain arrays in memory.

HT is an index permutation of H, exact for every period (axes and centre rule in `lfcal.base.axes`)::

    HT[z, y, x, t, s] = H[z, (y + t - ct) mod ny, (x + s - cs) mod nx, nt-1-t, ns-1-s]

``method="paper"`` implements equations 4 to 9 of M. Eberhart, "Efficient algorithm for calculating transposed PSF
matrices for 3D light field deconvolution" (arXiv:2003.09133, 2020) as printed. These equations give the
same values only where ``cx <= x + s < ns + cx`` and ``cy <= y + t < nt + cy`` with ``cx = (nx-1)/2``,
``cy = (ny-1)/2``; all other entries stay zero. Padding H beforehand by (nx-1)/2 and (ny-1)/2 zeros per side
(``"paper-padded"``) makes the result exact.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, centre, check_psf_shape, for_each_chunk

__all__ = ["BORDER_LIMIT", "border_energy", "border_warning", "depth_sum", "ht_slice", "transpose"]

BORDER_LIMIT = 0.001
"""Fraction of the energy near the edge of the cutout above which `border_warning` warns."""

GATHER_S, SUM_S = 2e-8, 2e-9
"""Additional processor time (s) per value of moving values by indices, and of sums by numpy, instead of by kernels."""


def transpose(
    array: Any,
    method: str = "exact",
    out: NDArray[Any] | None = None,
    workers: int | None = None,
) -> NDArray[Any]:
    """Return the transposed matrix HT of H, with the shape and dtype of H.

    Parameters
    ----------
    array
        H, ``(nz, ny, nx, nt, ns)``: an array, memory map or dataset of numbers, in any memory layout and byte order.
        One depth plane is read at a time.
    method
        ``"exact"``: the transpose. ``"paper"``: equations 4 to 9 of Eberhart as printed, which require an odd period
        and leave a border of zeros in HT. ``"paper-padded"``: these equations applied to zero-padded H, which yields
        the exact transpose.
    out
        Array to fill, with the shape and dtype of H, which must not share memory with H and is returned. None: a new
        array.
    workers
        Number of threads. None: one for each available CPU core.

    Raises
    ------
    InputError
        If the shape is not that of a PSF matrix, or the dtype is not numeric. Also if ``out`` has another shape or
        dtype or overlaps H, or the method requires an odd period and the period is even.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import transpose
    >>> H = np.arange(9).reshape(1, 1, 1, 3, 3)
    >>> transpose(H)[0, 0, 0].tolist()  # of a period of one pixel HT is H turned by 180 degrees
    [[8, 7, 6], [5, 4, 3], [2, 1, 0]]
    """
    shape = check_psf_shape(tuple(array.shape) if hasattr(array, "shape") else np.shape(array))
    source = array if hasattr(array, "dtype") else np.asarray(array)
    _check_dtype(source.dtype)
    _check_method(method, shape)
    result = np.empty(shape, source.dtype) if out is None else _checked_out(out, source, shape)
    if method == "exact" and isinstance(source, np.ndarray) and _plain(source) and _plain(result):
        _permute(source, result, workers)
        return result
    for z in range(shape[0]):
        plane, target = _as_plain(source[z]), result[z]
        turned = target if _plain(target) else np.empty(plane.shape, plane.dtype)
        _transpose_plane(plane, turned, method, workers)
        if turned is not target:
            target[...] = turned
    return result


def _plain(array: NDArray[Any]) -> bool:
    """Return whether the kernels can process the array as contiguous words."""
    return array.flags.c_contiguous and array.ctypes.data % min(array.itemsize, 8) == 0


def _as_plain(values: Any) -> NDArray[Any]:
    array = np.ascontiguousarray(values)
    return array if _plain(array) else array.copy()


def _transpose_plane(plane: NDArray[Any], out: NDArray[Any], method: str, workers: int | None) -> None:
    if method == "paper-padded":
        ny, nx, nt, ns = plane.shape
        cy, cx = centre(ny), centre(nx)
        # with zeros all around, the part that equations 4 to 9 drop is padding
        padded = np.pad(plane, ((0, 0), (0, 0), (cy, cy), (cx, cx)))
        turned = np.empty_like(padded)
        _transpose_plane(padded, turned, "paper", workers)
        out[...] = turned[:, :, cy : cy + nt, cx : cx + ns]
        return
    _permute(plane[None], out[None], workers)
    if method == "paper":
        _clear_border(out)


def _permute(source: NDArray[Any], out: NDArray[Any], workers: int | None) -> None:
    """Transpose contiguous ``(nz, ny, nx, nt, ns)`` exactly."""
    from lfcal.psf import _kernels

    nz, ny, _, nt, ns = shape = source.shape
    words, target = _as_words(source), _as_words(out, write=True)
    # the batched kernel moves LANES pixels of at most 8 bytes at a time
    if ns < _kernels.LANES or source.itemsize > 8:
        for plane, turned in zip(words, target, strict=True):
            for_each_chunk(partial(_kernels.transpose_rows, plane, turned), ny, workers)
        return
    if _kernels.transpose_batches.spared(GATHER_S * source.size):
        for plane, turned in zip(words, target, strict=True):
            _gather_rows(plane, turned)
        return
    batch = _kernels.batch_rows(shape, source.itemsize)
    batches = _kernels.Batches(shape, _kernels.source_rows(shape), batch)
    flat = (words.reshape(-1), target.reshape(-1), batches)

    def work(start: int, stop: int) -> None:
        _kernels.transpose_batches(*flat, _kernels.batch_memory(batches, words.dtype), start, stop)

    for_each_chunk(work, nz * -(-nt // batch), workers)


def _gather_rows(plane: NDArray[Any], out: NDArray[Any]) -> None:
    """Transpose a plane ``(ny, nx, nt, ns)`` exactly by indices, one row of the cutouts at a time."""
    ny, nx, nt, ns = plane.shape
    s = np.arange(ns)
    columns = (np.arange(nx)[:, None] + s - centre(ns)) % nx
    for t in range(nt):
        rows = (np.arange(ny) + t - centre(nt)) % ny
        out[:, :, t] = plane[rows[:, None, None], columns, nt - 1 - t, ns - 1 - s]


def _as_words(array: NDArray[Any], *, write: bool = False) -> NDArray[Any]:
    """Return the values as plain words of their size: they are moved, not computed with."""
    size = array.dtype.itemsize
    # same permutation for every type: a kernel compiled for each word size serves floats, integers and bool
    words = np.asarray(array).view(np.complex128 if size == 16 else f"u{size}")
    words.flags.writeable = write  # input is always read-only, so that each kernel is compiled only once
    return words


def _clear_border(plane: NDArray[Any]) -> None:
    """Set the entries that equations 4 to 9 do not write to zero."""
    ny, nx, nt, ns = plane.shape
    for y in range(ny):
        first = centre(ny) - y
        plane[y, :, : max(0, first)] = 0
        plane[y, :, max(0, nt + first) :] = 0
    for x in range(nx):
        first = centre(nx) - x
        plane[:, x, :, : max(0, first)] = 0
        plane[:, x, :, max(0, ns + first) :] = 0


def _check_dtype(dtype: np.dtype[Any]) -> None:
    if dtype.kind not in "biufc" or dtype.itemsize not in (1, 2, 4, 8, 16):
        raise InputError.expected(
            "PSF matrix",
            "integers, Boolean values, or real or complex numbers of up to 16 bytes",
            f"dtype {dtype}",
            "convert the matrix first",
        )


def _check_method(method: str, shape: tuple[int, ...]) -> None:
    if method not in ("exact", "paper", "paper-padded"):
        raise InputError.expected(
            "transpose method", "exact, paper or paper-padded", repr(method), "choose one of these"
        )
    ny, nx = shape[1:3]
    if method != "exact" and (ny % 2 == 0 or nx % 2 == 0):
        raise InputError.expected(
            f"transpose method {method}", "an odd period in y and x", f"{ny} x {nx}", "use the method exact"
        )


def _checked_out(out: NDArray[Any], source: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    if not isinstance(out, np.ndarray) or out.shape != shape or out.dtype != source.dtype:
        got = f"{out.dtype} of shape {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
        raise InputError.expected("out", f"{source.dtype} of shape {shape}", got, "make it with numpy.empty_like(H)")
    if not out.flags.writeable:
        raise InputError.expected(
            "out", "a writeable array", "a read-only one", "copy the array, or open it for writing"
        )
    if _overlap(source, out):
        raise InputError.expected("out", "separate memory", "memory shared with H", "transpose into another array")
    return out


def _overlap(source: Any, out: NDArray[Any]) -> bool:
    if not isinstance(source, np.ndarray):  # planes are read as they are needed; ask about the first
        first = source[0]
        return isinstance(first, np.ndarray) and _root(first) is _root(out)
    if isinstance(source, np.memmap) and isinstance(out, np.memmap) and source.filename == out.filename:
        return source.filename is not None
    try:
        return np.shares_memory(source, out, max_work=100_000)  # type: ignore[arg-type]  # the stubs know 0 and -1
    except np.exceptions.TooHardError:
        return True


def _root(array: NDArray[Any]) -> Any:
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def ht_slice(plane: NDArray[Any], y: int, x: int, out: NDArray[Any] | None = None) -> NDArray[Any]:
    """Return the slice ``HT[y, x]`` ``(nt, ns)`` of one depth plane, without building HT.

    Parameters
    ----------
    plane
        Depth plane of H, ``(ny, nx, nt, ns)``.
    y, x
        Position within the period; negative numbers count from the end.
    out
        Array ``(nt, ns)`` of H's dtype to fill. None: a new array.

    Raises
    ------
    InputError
        If the plane is not ``(ny, nx, nt, ns)`` with an odd cutout, or ``out`` does not fit.
    IndexError
        If there is no such position.
    """
    from lfcal.psf import _plane_kernels

    _, ny, nx, nt, ns = check_psf_shape((1, *plane.shape))
    _check_dtype(plane.dtype)
    if not (-ny <= y < ny and -nx <= x < nx):
        raise IndexError(f"position ({y}, {x}) is outside the period ({ny}, {nx})")
    if out is None:
        out = np.empty((nt, ns), plane.dtype)
    elif out.shape != (nt, ns) or out.dtype != plane.dtype or not out.flags.writeable:
        raise InputError.expected(
            "out",
            f"a writeable array, {plane.dtype} of shape {(nt, ns)}",
            f"{out.dtype} of shape {out.shape}",
            "make it with numpy.empty",
        )
    if _plain(plane) and _plain(out) and not _plane_kernels.gather_slice.spared(GATHER_S * out.size):
        flat = _as_words(plane).reshape(-1), _as_words(out, write=True).reshape(-1)
        _plane_kernels.gather_slice(flat[0], (ny, nx, nt, ns), y % ny, x % nx, flat[1])
    else:
        t, s = np.arange(nt)[:, None], np.arange(ns)
        out[...] = plane[(y + t - centre(nt)) % ny, (x + s - centre(ns)) % nx, nt - 1 - t, ns - 1 - s]
    return out


def depth_sum(plane: NDArray[Any], workers: int | None = None) -> NDArray[Any]:
    """Return the sum of a depth plane over all positions, ``(nt, ns)``, in float64 (complex128 for complex H).

    Every value is added in double precision. For n positions, the relative error of a sum of non-negative values is
    below n * 2**-53. Integer sums up to 2**53 are exact.

    Parameters
    ----------
    plane
        Depth plane of H, ``(ny, nx, nt, ns)``, any numeric dtype and memory layout.
    workers
        Number of threads. None: one for each available CPU core.
    """
    _, ny, nx, nt, ns = check_psf_shape((1, *plane.shape))
    _check_dtype(plane.dtype)
    plane = np.asarray(plane)
    kind: Any = np.complex128 if plane.dtype.kind == "c" else np.float64
    from lfcal.psf import _plane_kernels

    # numpy's own sum handles strides and foreign byte order; float16 and long double have no kernel
    special = not (_plain(plane) and plane.dtype.isnative) or plane.dtype in (np.float16, np.longdouble)
    if special or _plane_kernels.add_patterns.spared(SUM_S * plane.size):
        strided: NDArray[Any] = plane.sum(axis=(0, 1), dtype=kind)
        return strided
    patterns = plane.reshape(ny * nx, nt * ns)
    # real and imaginary parts are added separately, as twice the number of real columns
    if kind is np.complex128:
        patterns = patterns.view(plane.real.dtype)
    elif plane.dtype == np.bool_:
        patterns = patterns.view(np.uint8)
    patterns.flags.writeable = False
    total = np.zeros(patterns.shape[1])
    for_each_chunk(partial(_plane_kernels.add_patterns, patterns, total), total.size, workers)
    sums: NDArray[Any] = total.view(kind).reshape(nt, ns)
    return sums


def border_energy(H: Any) -> float:
    """Return the fraction of the energy of H that lies within ny // 2 rows or nx // 2 columns of the cutout's edge.

    Energy is the sum of absolute values over all positions and depths. Other codes lose part of this border when they
    transpose, as does ``method="paper"``; the exact method does not.
    """
    shape = check_psf_shape(tuple(H.shape))
    _, ny, nx, nt, ns = shape
    energy = np.zeros((nt, ns))
    for z in range(shape[0]):
        plane = np.asarray(H[z])
        # unsigned values need no abs(), so the fast sum can be used
        if plane.dtype.kind in "bu":
            energy += depth_sum(plane)
        else:
            # signed values would cancel: the energy of a background-subtracted pattern is that of its magnitudes
            for row in plane:
                energy += np.abs(row).sum(axis=0, dtype=np.float64)
    inner = energy[ny // 2 : nt - ny // 2, nx // 2 : ns - nx // 2].sum()
    total = energy.sum()
    return float(1 - inner / total) if total > 0 else 0.0


def border_warning(H: Any, limit: float = BORDER_LIMIT) -> str | None:
    """Return a warning if more than ``limit`` of the energy lies near the edge of the cutout, else None."""
    share = border_energy(H)
    if share <= limit:
        return None
    _, ny, nx, _, _ = check_psf_shape(tuple(H.shape))
    return (
        f"{100 * share:.2f} % of the energy is within {ny // 2} rows or {nx // 2} columns of the cutout's edge, "
        "where the transposers of other codes (and the method paper) drop values; choose a larger cutout, or "
        "transpose with the method exact"
    )
