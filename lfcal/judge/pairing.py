"""Parts of two H that can be compared (planes, positions and pixels), and notes on what is left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, centre, format_plane
from lfcal.psf import PSFMatrix

__all__ = ["Pair", "pair"]

CLOSE = 0.05
"""Difference of depths, as a fraction of the distance between planes, up to which planes are the same."""

FRACTION = 0.01
"""Difference between the anchors of equal positions above which it is reported (pixels)."""

F8 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pair:
    """Two H, and the parts of them to compare.

    Attributes
    ----------
    a, b
        The matrices.
    planes
        Pairs of plane indices (of ``a``, of ``b``) to compare.
    moved
        Position (y, x) of ``b`` that corresponds to position (0, 0) of ``a``.
    cutout
        Size ``(nt, ns)`` of the common part of the cutouts around the source (pixels).
    notes
        Notes on what is left out, with the reason.
    """

    a: PSFMatrix
    b: PSFMatrix
    planes: tuple[tuple[int, int], ...]
    moved: tuple[int, int]
    cutout: tuple[int, int]
    notes: tuple[str, ...]

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Shape ``(nz, ny, nx, nt, ns)`` of the compared parts."""
        return (len(self.planes), *self.a.period, *self.cutout)

    def there(self, k: int) -> NDArray[np.bool_]:
        """Return a mask ``(ny, nx)`` for pair ``k`` of planes, True at positions of ``a`` recorded in both H."""
        za, zb = self.planes[k]
        ours = np.asarray(self.a.recorded[za]) > 0
        theirs = np.asarray(self.b.recorded[zb]) > 0
        found: NDArray[np.bool_] = ours & np.roll(theirs, (-self.moved[0], -self.moved[1]), (0, 1))
        return found

    def place_in_b(self, y: int, x: int) -> tuple[int, int]:
        """Return the position (y, x) of ``b``, within its period, that corresponds to position (y, x) of ``a``."""
        ny, nx = self.a.period
        return (y + self.moved[0]) % ny, (x + self.moved[1]) % nx

    def patterns(self, k: int, y: int, x: int) -> tuple[F8, F8]:
        """Return the patterns ``(nt, ns)`` of ``a`` and ``b`` at position (y, x) of ``a``, in pair ``k`` of planes."""
        za, zb = self.planes[k]
        return self.crop(self.a[za, y, x]), self.crop(self.b[(zb, *self.place_in_b(y, x))])

    def row(self, k: int, y: int) -> tuple[F8, F8]:
        """Return the patterns ``(nx, nt, ns)`` of ``a`` and ``b`` along row ``y`` of ``a``, in pair ``k`` of planes."""
        za, zb = self.planes[k]
        other, first = self.place_in_b(y, 0)
        return self.crop(self.a[za, y]), np.roll(self.crop(self.b[zb, other]), -first, 0)

    def crop(self, patterns: ArrayLike) -> F8:
        """Return ``patterns`` ``(..., t, s)`` cropped to the common part of the cutouts ``(..., nt, ns)``."""
        values = np.asarray(patterns)
        at = tuple(centre(have) - centre(want) for have, want in zip(values.shape[-2:], self.cutout, strict=True))
        rows, columns = (slice(first, first + n) for first, n in zip(at, self.cutout, strict=True))
        return np.asarray(values[..., rows, columns], np.float64)


def pair(
    a: PSFMatrix | ArrayLike, b: PSFMatrix | ArrayLike, *, by_number: bool = False, by_index: bool = False
) -> Pair:
    """Return the common parts of two H for a comparison.

    Planes are matched by their depths if both H state them, and otherwise by their indices. Source positions are
    matched by their position on the sensor if both H state a camera, and otherwise by their indices.

    Parameters
    ----------
    a, b
        The two H; for a transposed view, its H is used.
    by_number
        Whether to match planes by their indices instead of by their depths.
    by_index
        Whether to match planes and positions by their indices, whatever their positions on the sensor; the shapes must
        be equal.

    Raises
    ------
    InputError
        If the periods or the numbers of pixels per sensor pixel differ, no depth is common, or an H is complex. With
        ``by_index``, also if the shapes differ.
    """
    first, second = (_straight(m) for m in (a, b))
    for matrix, which in ((first, "first"), (second, "second")):
        if matrix.dtype.kind == "c":
            raise InputError.expected(_called(matrix, which), "real numbers", "complex ones", "give intensities")
    if by_index and first.shape != second.shape:
        remedy = "give an H with the same positions and cutout"
        raise InputError.expected(_called(second, "second"), f"shape {first.shape}", f"shape {second.shape}", remedy)
    for name, own, other in (
        ("period (y, x)", first.period, second.period),
        ("pixels per sensor pixel", first.pixel_scale, second.pixel_scale),
    ):
        if own != other:
            wanted = f"{own}, as in {_called(first, 'first')}"
            remedy = "compare H with the same array and sampling"
            raise InputError.expected(f"{_called(second, 'second')}, {name}", wanted, other, remedy)
    notes: list[str] = []
    if first.path and (first.path, first.region) == (second.path, second.region):
        notes.append("both are the same file")
    names = [m.camera.name for m in (first, second) if m.camera is not None]
    if len(set(names)) > 1:
        notes.append(f"the names of the cameras differ: {names[0]} and {names[1]}")
    planes = _planes(first, second, by_number or by_index, notes)
    moved = (0, 0) if by_index else _moved(first, second, notes)
    rows, columns = (min(n, m) for n, m in zip(first.cutout, second.cutout, strict=True))
    if first.cutout != second.cutout:
        sizes = " and ".join(f"{nt} × {ns}" for nt, ns in (first.cutout, second.cutout))
        notes.append(f"cutouts of {sizes} pixels: {rows} × {columns} pixels around the source are compared")
    return Pair(first, second, planes, moved, (rows, columns), tuple(notes))


def _straight(matrix: PSFMatrix | ArrayLike) -> PSFMatrix:
    H = matrix if isinstance(matrix, PSFMatrix) else PSFMatrix(matrix)
    return H.T if H.is_transposed else H


def _called(matrix: PSFMatrix, which: str) -> str:
    """Return the name of an H for an error message: its file, and whether it is the first or the second."""
    return f"{matrix.path} (the {which} H)" if matrix.path else f"{which} H"


def _planes(a: PSFMatrix, b: PSFMatrix, by_number: bool, notes: list[str]) -> tuple[tuple[int, int], ...]:
    """Return pairs of planes with the same depth, or with the same index if ``by_number``."""
    known = a.knows_depths and b.knows_depths
    if by_number or not known:
        common = min(len(a), len(b))
        apart = [z for z in range(common) if known and abs(a.depths[z] - b.depths[z]) > _close(a, b)]
        if not by_number and a.knows_depths != b.knows_depths:
            which = "second" if a.knows_depths else "first"
            notes.append(f"the {which} H does not state depths: planes with equal numbers are compared")
        if apart:
            notes.append(f"planes with equal numbers are compared; {len(apart)} of them differ in depth")
        _left_out(notes, "first", a, range(common))
        _left_out(notes, "second", b, range(common))
        return tuple((z, z) for z in range(common))
    close = _close(a, b)
    found: list[tuple[int, int]] = []
    free = set(range(len(b)))
    for z, depth in enumerate(a.depths.tolist()):
        near = min(free, key=lambda k: abs(float(b.depths[k]) - depth), default=None)
        if near is not None and abs(float(b.depths[near]) - depth) <= close:
            found.append((z, near))
            free.discard(near)
    if not found:
        raise InputError.expected(
            f"{_called(b, 'second')}, depths",
            f"at least one of {_listed(a, range(len(a)))}",
            _listed(b, range(len(b))),
            "compare the planes by their numbers (--by-number)",
        )
    _left_out(notes, "first", a, [z for z, _ in found])
    _left_out(notes, "second", b, [z for _, z in found])
    return tuple(found)


def _close(a: PSFMatrix, b: PSFMatrix) -> float:
    """Return the largest difference between depths of the same plane (µm)."""
    steps = [float(np.diff(np.sort(m.depths)).min()) for m in (a, b) if len(m) > 1]
    steps = [step for step in steps if step > 0]
    if steps:
        return CLOSE * min(steps)
    # with a single plane, the distance of neighbours is unknown
    return max(1.0, 1e-3 * float(np.abs(a.depths).max()))


def _left_out(notes: list[str], which: str, matrix: PSFMatrix, used: range | list[int]) -> None:
    alone = [z for z in range(len(matrix)) if z not in used]
    if alone:
        words = "plane" if len(alone) == 1 else "planes"
        notes.append(f"{words} only in the {which} H: {_listed(matrix, alone)}")


def _listed(matrix: PSFMatrix, planes: range | list[int]) -> str:
    reported = [format_plane(float(matrix.known_depths[z]), z) for z in planes]
    return ", ".join(reported[:6]) + (f" and {len(reported) - 6} more" if len(reported) > 6 else "")


def _moved(a: PSFMatrix, b: PSFMatrix, notes: list[str]) -> tuple[int, int]:
    """Return the position of ``b`` that is position (0, 0) of ``a``, by sensor pixels if both state a camera."""
    if a.camera is None or b.camera is None:
        return 0, 0
    apart = [own - other for own, other in zip(a.anchor, b.anchor, strict=True)]
    whole = [round(v) for v in apart]
    rest = [v - n for v, n in zip(apart, whole, strict=True)]
    if max(map(abs, rest)) > FRACTION:
        notes.append(f"the two scans are ({rest[0]:.3g}, {rest[1]:.3g}) pixels apart; the shifts include this distance")
    moved = (whole[0] % a.period[0], whole[1] % a.period[1])
    if moved != (0, 0):
        notes.append(
            f"positions are paired by their location on the sensor: (0, 0) of the first H is {moved} of the second"
        )
    return moved
