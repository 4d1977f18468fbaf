"""The grid of lenses of a Raytrix calibration file: entries with their units, rotation, offset, order of the types."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError
from lfcal.camera.lattice import LensletLattice, LensType

__all__ = ["entry_of", "float_of", "lens_types", "number_of", "pair_of", "placement"]

FLIP_Y = np.array([1.0, -1.0])
"""The file counts y upwards; images count it downwards."""


def entry_of(parent: ElementTree.Element, tag: str, source: Path) -> ElementTree.Element:
    """Return the one entry ``tag`` of ``parent``."""
    found = parent.findall(tag)
    if len(found) != 1:
        raise FileFormatError.expected(
            f"{source}: <{tag}> in <{parent.tag}>", "one", len(found), "export the file again"
        )
    return found[0]


def number_of(parent: ElementTree.Element, tag: str, units: str | None, source: Path) -> float:
    """Return the number in the entry ``tag``, whose units, where it names any, must be ``units``."""
    entry = entry_of(parent, tag, source)
    if units is not None:
        _check_units(entry, units, source)
    return float_of(entry.text, f"{source}: <{tag}>")


def float_of(text: str | None, what: str) -> float:
    """Return the finite number that ``text`` is."""
    try:
        value = float((text or "").strip())
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        got = repr((text or "").strip()[:40])
        raise FileFormatError.expected(what, "a number", got, "export the file again")
    return value


def _check_units(entry: ElementTree.Element, units: str, source: Path) -> None:
    if entry.get("units", units) != units:
        raise FileFormatError.expected(
            f"{source}: <{entry.tag}>", f'units "{units}"', repr(entry.get("units")), "export it again"
        )


def pair_of(parent: ElementTree.Element, tag: str, units: str, source: Path) -> NDArray[np.float64]:
    """Return the vector (x, y) in the entry ``tag``."""
    entry = entry_of(parent, tag, source)
    _check_units(entry, units, source)
    return np.array([number_of(entry, axis, None, source) for axis in ("x", "y")])


def lens_types(root: ElementTree.Element, source: Path) -> tuple[NDArray[np.float64], tuple[tuple[float, float], ...]]:
    """Return the types' offsets ``(n, 2)`` (lens diameters, y up) and depth ranges, by the file's ids."""
    found = {entry.get("id", ""): entry for entry in root.findall("lens_type")}
    names = [str(k) for k in range(len(found))]
    if len(found) not in (1, 3) or sorted(found) != names or len(root.findall("lens_type")) != len(found):
        got = ", ".join(sorted(found)) or "none"
        raise FileFormatError.expected(f"{source}: lens types", "ids 0, or 0, 1 and 2", got, "export it again")
    offsets = np.array([pair_of(found[k], "offset", "lens", source) for k in names])
    ranges = []
    for k in names:
        entry = entry_of(found[k], "depth_range", source)
        _check_units(entry, "virtual_depth", source)
        ranges.append((number_of(entry, "min", None, source), number_of(entry, "max", None, source)))
    return offsets, tuple(ranges)


def placement(
    root: ElementTree.Element, diameter: float, offsets: NDArray[np.float64], source: Path
) -> tuple[float, tuple[float, float], int]:
    """Return rotation (rad), offset (x, y) (px, y down) of a type-0 lens, and the step of types along a row."""
    # unit vectors at 60 or 120 degrees
    base = np.array([pair_of(root, f"lens_base_{axis}", "lens", source) for axis in "xy"])
    if abs(np.linalg.norm(base, axis=1) - 1).max() > 0.01 or abs(abs(base[0] @ base[1]) - 0.5) > 0.01:
        got = f"{base.round(3).tolist()}"
        raise FileFormatError.expected(f"{source}: lens bases", "a hexagonal lattice", got, "export it again")
    _check_sub_grid(pair_of(root, "sub_grid_base", "lens", source), len(offsets), source)
    # y up to y down turns a counter-clockwise angle into one from +x towards +y of the opposite sign
    turn = -number_of(root, "rotation", "rad", source)
    row = _row_angle(math.atan2(-base[0, 1], base[0, 0]) + turn)
    c, s = math.cos(turn), math.sin(turn)
    centres = pair_of(root, "offset", "pix", source) * FLIP_Y + (
        diameter * (offsets * FLIP_Y) @ np.array([[c, s], [-s, c]])
    )
    step = 1
    if len(offsets) == 3:
        # type 0 must lie at the origin of the indices, and the others where LensletLattice colours its neighbours
        lattice = LensletLattice("hexagonal", diameter, 1.0, (LensType(1.0),) * 3, row, tuple(centres[0]))
        index = (centres - centres[0]) @ np.linalg.inv(lattice.basis_um())
        whole = np.rint(index).astype(int)
        found = lattice.type_of(whole[:, 0], whole[:, 1])
        if abs(index - whole).max() > 0.05 or len(set(found.tolist())) != 3:
            got = offsets.round(3).tolist()
            raise FileFormatError.expected(
                f"{source}: lens type offsets", "neighbours of three types", got, "export it again"
            )
        step = 1 if found[1] == 1 else 2
    return row, (float(centres[0, 0]), float(centres[0, 1])), step


def _row_angle(angle: float) -> float:
    """Return the angle, of those 60 degrees apart, that lies nearest a sensor axis (rad, in [0, 90] or so)."""
    sixth, quarter = math.pi / 3, math.pi / 2
    # a hexagonal lattice looks the same every 60 degrees; the rounding makes ties between equal angles repeatable
    candidates = [angle + k * sixth for k in range(-6, 7)]
    return min(candidates, key=lambda a: (round(abs(a - quarter * round(a / quarter)), 9), round(abs(a), 9)))


def _check_sub_grid(vector: NDArray[np.float64], types: int, source: Path) -> None:
    """Raise unless the sub-grid is the rectangular cell that the lattice implies: (3, √3) lenses for three types."""
    wanted = (3.0 if types == 3 else 1.0, math.sqrt(3))
    if np.abs(np.abs(vector) - wanted).max() > 0.01:
        got = np.abs(vector).round(4).tolist()
        raise FileFormatError.expected(
            f"{source}: sub-grid base", f"({wanted[0]:g}, {wanted[1]:.4f}) lenses", got, "export it again"
        )
