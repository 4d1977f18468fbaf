"""Several representative regions of the field in one plan; each is scanned according to a `ScanPlan`."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    FileFormatError,
    InputError,
    check_tuple,
    check_type,
    format_count,
    format_pixels,
    parse_json,
    stated_format,
)
from lfcal.camera.description import nearest_lens
from lfcal.camera.plan import ScanPlan

__all__ = ["RegionPlan", "parse_regions"]

FORMAT = "lfcal-region-plan"
VERSION = 1
MAX_REGIONS = 100
"""Largest number of regions; more would be a scan of the whole field."""

PHASE_TOLERANCE_PX = 0.05
"""Largest difference of phase between regions (px), if the array allows it within a few periods."""

SEARCH_PERIODS = 6
"""Largest distance from its ideal position at which an anchor is searched for, in periods."""


@dataclass(frozen=True, slots=True)
class RegionPlan:
    """Plan for scanning one cell of the lattice in each of several regions of the field, one after another.

    Attributes
    ----------
    scan
        Scan plan of the first region: camera, planes, cutout, exposures. The plans of other regions differ only in
        their anchors.
    names
        Names of the regions in an H file and in the folders of a session: up to 40 letters, digits, ``-`` and ``_``.
        Two names must differ in more than upper and lower case.
    anchors
        Sensor position ``(row, column)`` (px) of the image of position (0, 0) in each region; the first one is that of
        `scan`.

    Examples
    --------
    >>> from lfcal.camera import RegionPlan, ScanPlan, preset
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3], cutout=63)
    >>> regions = RegionPlan.spread(scan, (1, 3))
    >>> print(regions.names, regions.anchors)
    ('centre', 'r1c1', 'r1c3') ((150.0, 144.0), (150.0, 45.0), (150.0, 243.0))
    """

    scan: ScanPlan
    names: tuple[str, ...]
    anchors: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        """Check every value, and that every region's cutouts are on the sensor."""
        check_type("scan", self.scan, ScanPlan)
        names, anchors = tuple(self.names), tuple(check_tuple("anchor (row, column)", a, 2) for a in self.anchors)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "anchors", anchors)
        bad = [name for name in names if not (isinstance(name, str) and re.fullmatch(r"[A-Za-z0-9_-]{1,40}", name))]
        if bad or len({name.lower() for name in names}) < len(names) or not 1 <= len(names) <= MAX_REGIONS:
            wanted = f"1 to {MAX_REGIONS} different names of letters, digits, _ and -"
            got, remedy = repr(bad[0]) if bad else ", ".join(names[:8]), "rename the regions"
            if not 1 <= len(names) <= MAX_REGIONS:
                got, remedy = format_count(len(names), "name", "names"), "change the number of regions"
            raise InputError.expected("regions of the field", wanted, got, remedy)
        if len(anchors) != len(names):
            wanted = f"one for each of the {len(names)} regions"
            raise InputError.expected("anchors of the regions", wanted, len(anchors), "give one anchor for each region")
        if anchors[0] != self.scan.anchor:
            raise InputError.expected(
                "first anchor of the regions",
                f"{self.scan.anchor}, the anchor of the scan",
                anchors[0],
                "start with the anchor of the scan",
            )
        for k in range(len(names)):
            self.plan(k)

    def __len__(self) -> int:
        """Return the number of regions."""
        return len(self.names)

    def plan(self, k: int) -> ScanPlan:
        """Return the scan plan of the region with index ``k``; 0 is the first region."""
        return replace(self.scan, anchor=self.anchors[k])

    def residual_px(self, k: int) -> tuple[float, float]:
        """Return `ScanPlan.lattice_anchor` (row, column) (px) of region ``k`` minus that of the first region."""
        first, own = self.plan(0).lattice_anchor, self.plan(k).lattice_anchor
        return own[0] - first[0], own[1] - first[1]

    @classmethod
    def spread(cls, scan: ScanPlan, shape: tuple[int, int]) -> RegionPlan:
        """Return a plan with regions in ``shape`` (rows, columns) over the field; the most central region is first.

        Ideally, the regions are equally spaced, and the outermost ones are as far from the centre as their cutouts
        allow. Anchors are integer pixels within a few periods of these ideal positions. They are chosen such that a
        position of the scan has nearly the same phase relative to the lattice in every region. `residual_px` returns
        the remaining difference.

        Raises
        ------
        InputError
            If the sensor is too small for this number of regions, or the number is one or too large.
        """
        rows, columns = _checked(*check_tuple("regions (rows, columns)", shape, 2, integer=True, at_least=1))
        low, high = _room(scan)
        middle = (low + high) / 2
        # at most a quarter of the way to the next region, if a cell fits
        apart = (high - low) / np.maximum(np.array([rows, columns]) - 1, 1)
        period = np.array(scan.cell_camera.period_px)
        reach = np.clip(apart / 4, period, SEARCH_PERIODS * period)
        found: dict[str, tuple[float, float]] = {}
        for r, down in enumerate(_places(low[0], high[0], rows)):
            for c, along in enumerate(_places(low[1], high[1], columns)):
                name = "centre" if (2 * r + 1, 2 * c + 1) == (rows, columns) else f"r{r + 1}c{c + 1}"
                found[name] = _anchor_of_phase(scan, np.array([down, along]), low, high, reach)
        order = sorted(found, key=lambda name: float(np.hypot(*(np.array(found[name]) - middle))))
        names = [order[0], *(name for name in found if name != order[0])]
        anchors = [found[name] for name in names]
        if len(set(anchors)) < len(anchors):
            wanted = f"a sensor with room for {rows} x {columns} of {scan.cutout[0]} x {scan.cutout[1]} px"
            raise InputError.expected(
                "regions",
                wanted,
                f"one of {format_pixels(scan.camera.sensor.shape)}",
                "choose fewer regions, or a smaller cutout",
            )
        return cls(replace(scan, anchor=anchors[0]), tuple(names), tuple(anchors))

    # -- JSON ------------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain JSON types."""
        regions = [{"name": n, "anchor": list(a)} for n, a in zip(self.names, self.anchors, strict=True)]
        return {"format": FORMAT, "version": VERSION, "regions": regions, "scan": self.scan.to_dict()}

    def to_json(self) -> str:
        """Return the plan as JSON text."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    @classmethod
    def is_one(cls, data: Any) -> bool:
        """Return whether ``data`` states the format of a plan of regions; its contents are not checked."""
        return isinstance(data, Mapping) and data.get("format") == FORMAT

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> RegionPlan:
        """Return the plan described by the result of `to_dict`.

        Another format or version, and unknown or missing entries, raise `FileFormatError`; invalid values raise
        `InputError`.
        """
        what = "plan of regions"
        if not cls.is_one(data) or data.get("version") != VERSION:
            wanted = f'"format": "{FORMAT}", version {VERSION}'
            raise FileFormatError.expected(
                what,
                wanted,
                stated_format(data),
                "choose a plan of several regions (lfcal plan --regions), or update lfcal",
            )
        regions = data.get("regions")
        if set(data) != {"format", "version", "regions", "scan"} or not isinstance(regions, list):
            raise FileFormatError.expected(
                what,
                "the entries format, version, regions and scan",
                sorted(data),
                "make the plan again with its regions (lfcal plan --regions)",
            )
        for one in regions:
            if not isinstance(one, Mapping) or set(one) != {"name", "anchor"}:
                raise FileFormatError.expected(
                    f"{what}: region",
                    "a name and an anchor",
                    repr(one)[:60],
                    "make the plan again with its regions (lfcal plan --regions)",
                )
        names, anchors = tuple(one["name"] for one in regions), tuple(one["anchor"] for one in regions)
        return cls(ScanPlan.from_dict(data["scan"]), names, anchors)

    @classmethod
    def from_json(cls, text: str) -> RegionPlan:
        """Return the plan described by ``text``, as returned by `to_json`."""
        return cls.from_dict(parse_json(text, "plan of regions"))


def parse_regions(text: str) -> tuple[int, int]:
    """Return the numbers of rows and columns of regions from a text such as ``3x3``.

    Another form, a single region, or too many regions raise `InputError`.
    """
    match = re.fullmatch(r"\s*(\d{1,9})\s*[x×]\s*(\d{1,9})\s*", text)
    if match is None:
        raise InputError.expected("regions", "ROWSxCOLUMNS", repr(text), "give two whole numbers: 3x3")
    return _checked(int(match[1]), int(match[2]))


def _checked(rows: int, columns: int) -> tuple[int, int]:
    """Return rows and columns of regions after checking their numbers."""
    if not 1 < rows * columns <= MAX_REGIONS:
        raise InputError.expected(
            "regions (rows, columns)",
            f"2 to {MAX_REGIONS} in all",
            f"{rows}x{columns}",
            "choose another number of rows and columns, such as 3x3",
        )
    return rows, columns


def _room(scan: ScanPlan) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and the largest anchor (row, column) whose cutouts are on the sensor."""
    factors = np.array(scan.resample_factors)
    half = np.ceil((np.array(scan.cutout) - 1) / 2 / factors)
    reach = np.ceil((np.array(scan.period) - 1) / factors)
    low, high = half, np.array(scan.camera.sensor.shape) - 1 - half - reach
    if (high < low).any():
        raise InputError.expected(
            "regions",
            "a sensor larger than one period of the scan",
            f"one of {format_pixels(scan.camera.sensor.shape)}",
            "plan one scan, without regions",
        )
    return low, high


def _places(low: float, high: float, count: int) -> NDArray[np.float64]:
    return np.array([(low + high) / 2]) if count == 1 else np.linspace(low, high, count)


def _anchor_of_phase(
    scan: ScanPlan,
    place: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    reach: NDArray[np.float64],
) -> tuple[float, float]:
    """Return the integer anchor near ``place`` with the scan's phase, to `PHASE_TOLERANCE_PX` if possible."""
    camera = scan.camera
    offset = np.array(scan.anchor) - nearest_lens(camera, scan.anchor)
    pixel = camera.sensor.pixel_um
    about = camera.sensor_um((float(place[0]), float(place[1])))
    tall, wide = (reach * pixel).tolist()
    centres, types = camera.lattice.lenslets_within(wide, tall, (float(about[0]), float(about[1])))
    exact = place + (centres[types == 0] - about)[:, ::-1] / pixel + offset
    whole = np.rint(exact)
    there = ((whole >= low) & (whole <= high)).all(axis=1)
    if not there.any():
        raise InputError.expected(
            "region", "an anchor on the sensor, in phase with the scan", "none", "choose fewer regions"
        )
    exact, whole = exact[there], whole[there]
    # residuals below the tolerance count as equal; among them choose the nearest
    residual = np.maximum(np.abs(exact - whole).max(axis=1), PHASE_TOLERANCE_PX)
    away = np.hypot(*(whole - place).T)
    row, column = whole[np.lexsort((away, np.round(residual, 3)))[0]].tolist()
    return row, column
