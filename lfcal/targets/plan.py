"""The plan of a target: the scan whose positions it shows, the target, and its offset and lit points in each frame."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lfcal.base import FileFormatError, InputError, check_number, check_tuple, check_type, parse_json, stated_format
from lfcal.camera import Forecast, RegionPlan, ScanPlan, build, readout_hours
from lfcal.targets.images import HoleImages, hole_images, whole_at
from lfcal.targets.offsets import covered_by
from lfcal.targets.phases import Phases
from lfcal.targets.target import Target

__all__ = ["TargetForecast", "TargetPlan", "lit_blocks", "lit_by", "lit_matrix", "region_points"]

Lit = tuple[tuple[tuple[int, ...], ...], ...]
"""For each plane and frame, the numbers of the offsets that the frame shows."""

MOST = 4096
"""Largest number of offsets of a plane that are decoded."""


def lit_by(code: NDArray[Any], count: int) -> tuple[tuple[int, ...], ...]:
    """Return the numbers of the offsets that each frame shows, if ``code`` is applied to each group of offsets.

    Parameters
    ----------
    code
        Square matrix of 0 and 1 ``(frames, offsets)``: the offsets of a group that each of its frames shows.
    count
        Number of offsets, a multiple of the group's size.

    Raises
    ------
    InputError
        If ``code`` is not square, or ``count`` is not a multiple of the group's size.
    """
    order = len(code)
    if code.shape != (order, order) or count % order:
        raise InputError.expected(
            "offsets that are shown together", f"a multiple of {order}", count, "add the missing offsets"
        )
    return tuple(tuple(group + int(m) for m in np.flatnonzero(row)) for group in range(0, count, order) for row in code)


def checked_lit(lit: Any, counts: Sequence[int]) -> Lit:
    """Return the offsets shown by the frames of each plane; raise `InputError` unless each offset can be decoded.

    ``lit`` has the form of `TargetPlan.lit`, and ``counts`` contains the number of offsets of each plane. Each plane
    must have as many frames as offsets, at most `MOST`.
    """
    what = "offsets lit in each frame"
    check_type(what, lit, (tuple, list))
    found = []
    if len(lit) != len(counts):
        raise InputError.expected(what, f"a list for each of {len(counts)} planes", len(lit), "give one list per plane")
    for plane, count in zip(lit, counts, strict=True):
        check_type(what, plane, (tuple, list))
        if len(plane) != count or count > MOST:
            raise InputError.expected(
                what,
                f"{count} frames, as many as offsets, and at most {MOST}",
                len(plane),
                "give as many frames as offsets",
            )
        for one in plane:
            check_type(what, one, (tuple, list))
        frames = tuple(check_tuple(what, one, len(one), integer=True, at_least=0, at_most=count - 1) for one in plane)
        if not all(frames) or any(len(set(one)) < len(one) for one in frames):
            raise InputError.expected(
                what, "at least one offset, and each offset once", "no offset, or a repeated one", "correct the frame"
            )
        if not _solvable(frames, count):
            raise InputError.expected(
                what, "frames that determine every offset", "frames that do not", "use an S-matrix"
            )
        found.append(frames)
    return tuple(found)


def lit_matrix(frames: Sequence[Sequence[int]], count: int) -> NDArray[np.float64]:
    """Return a matrix ``(frames, count)`` that is 1 where a frame shows an offset, and 0 elsewhere."""
    out = np.zeros((len(frames), count))
    for row, one in zip(out, frames, strict=True):
        row[list(one)] = 1.0
    return out


def lit_blocks(frames: Sequence[Sequence[int]], count: int) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return the independent groups of frames and offsets, each as indices of its frames and of its offsets."""
    rows = np.repeat(np.arange(len(frames)), [len(one) for one in frames])
    columns = np.concatenate([np.asarray(one, np.intp) for one in frames]) if frames else np.zeros(0, np.intp)
    graph = coo_array((np.ones(len(rows)), (rows, len(frames) + columns)), shape=(len(frames) + count,) * 2)
    number, group = connected_components(graph, directed=False)
    nodes = [np.flatnonzero(group == k) for k in range(number)]
    return [(own[own < len(frames)], own[own >= len(frames)] - len(frames)) for own in nodes]


def _solvable(frames: Sequence[Sequence[int]], count: int) -> bool:
    whole = lit_matrix(frames, count)
    return all(
        len(rows) == len(columns) == np.linalg.matrix_rank(whole[np.ix_(rows, columns)])
        for rows, columns in lit_blocks(frames, count)
    )


FORMAT = "lfcal-target-plan"
VERSION = 1
MOST_OFFSETS = 10_000_000

Offsets = tuple[tuple[tuple[float, float], ...], ...]


@dataclass(frozen=True, slots=True)
class TargetForecast:
    """Predicted time for a plan of a target, computed as in `lfcal.camera.Forecast`.

    Attributes
    ----------
    frames
        Total number of frames, including those that are averaged.
    exposure_hours, settle_hours, move_hours
        Time for exposures, for settling, and for moves (h).
    readout_hours
        Time for readout (h); None if the camera's frame rate is unknown.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import TargetForecast, TargetPlan, parse_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31, exposure_s=0.1, frames_averaged=6)
    >>> plan = TargetPlan(scan, parse_target("array:3x3@2mm"), (((0.0, 0.0),) * 60,), 0.1, (0.0,), "geometric")
    >>> forecast: TargetForecast = plan.forecast()
    >>> print(f"{forecast.frames} frames, {3600 * forecast.exposure_hours:.0f} s exposed")
    360 frames, 36 s exposed
    >>> print(f"{plan.single().frames} frames of a single point")
    3762 frames of a single point
    """

    frames: int
    exposure_hours: float
    settle_hours: float
    move_hours: float
    readout_hours: float | None = None

    @property
    def hours(self) -> float:
        """Total time (h), including readout if known."""
        return self.exposure_hours + self.settle_hours + self.move_hours + (self.readout_hours or 0.0)


@dataclass(frozen=True, slots=True)
class TargetPlan:
    """Plan of the position of a target in each frame.

    Attributes
    ----------
    scan
        Scan of a single point whose positions the frames show; it defines camera, planes, cutout, stage and exposures.
    target
        The target, with its pose at zero offset.
    offsets_px
        For each plane, the displacements (rows, columns) of images of points in the depth plane (px), one for each
        frame.
    tolerance_px
        Largest difference between the phase of an image and that of a position that it shows, in rows and in columns
        (px).
    crosstalk
        For each plane, the largest light from neighbouring holes in a cutout, as a fraction of the light from the hole
        at its centre, for equally bright holes.
    tails
        Method with which ``crosstalk`` was computed: ``"geometric"`` (rays, without diffraction), or a level of wave
        optics.
    lit
        For a target with switchable points (a display): for each plane and each recorded frame, the numbers of the
        offsets whose points are lit together. There are as many frames as offsets, and single offsets are decoded from
        them (`lfcal.targets.coded`). None: frame k shows offset k.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import TargetPlan, parse_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> offsets = ((0.0, 0.0), (0.0, 1.0), (0.0, 2.0))
    >>> plan = TargetPlan(scan, parse_target("array:3x3@2mm"), (offsets,), 0.1, (0.0,), "geometric")
    >>> print("right, down in µm:", plan.offsets_um(0).round(1).tolist())
    right, down in µm: [[0.0, 0.0], [25.0, 0.0], [50.0, 0.0]]
    >>> print(f"{plan.points_a_frame(0)[1]} points a frame: at least {plan.least_frames(0)} for 19 x 33 positions")
    9 points a frame: at least 70 for 19 x 33 positions
    """

    scan: ScanPlan
    target: Target
    offsets_px: Offsets
    tolerance_px: float
    crosstalk: tuple[float, ...]
    tails: str
    lit: Lit | None = None

    def __post_init__(self) -> None:
        """Check every value, and that the camera images the target in every plane."""
        check_type("scan", self.scan, ScanPlan)
        check_type("target", self.target, Target)
        check_number("tolerance of a phase (px)", self.tolerance_px, above=0, at_most=0.5)
        check_type("computation of tails", self.tails, str)
        planes = len(self.scan.depths_um)
        object.__setattr__(self, "crosstalk", check_tuple("crosstalk", self.crosstalk, planes, at_least=0))
        check_type("offsets of the target", self.offsets_px, (tuple, list))
        if len(self.offsets_px) != planes or sum(map(len, self.offsets_px)) > MOST_OFFSETS:
            wanted = f"one list for each of the {planes} planes, and at most {MOST_OFFSETS} offsets"
            got = f"{len(self.offsets_px)} lists, {sum(map(len, self.offsets_px))} offsets"
            raise InputError.expected(
                "offsets of the target", wanted, got, "give one list per plane, or reduce the offsets"
            )
        offsets = tuple(
            tuple(check_tuple("offset (rows, columns) (px)", offset, 2) for offset in plane)
            for plane in self.offsets_px
        )
        object.__setattr__(self, "offsets_px", offsets)
        if self.lit is not None:
            object.__setattr__(self, "lit", checked_lit(self.lit, [len(plane) for plane in offsets]))
        for z in range(planes):
            self.images(z)

    # -- frames ----------------------------------------------------------------------------------------
    @property
    def frames(self) -> tuple[tuple[int, int], ...]:
        """All frames as (plane index, offset number), in the order of recording."""
        return tuple((z, k) for z, plane in enumerate(self.offsets_px) for k in range(len(plane)))

    def lit_in(self, z: int, k: int) -> tuple[int, ...]:
        """Return the numbers of the offsets that recorded frame ``k`` of plane ``z`` shows."""
        return (k,) if self.lit is None else self.lit[z][k]

    def images(self, z: int) -> HoleImages:
        """Return the positions of the images of all holes in plane ``z`` at zero offset."""
        return hole_images(self.target, self.scan.camera, self.scan.depths_um[z])

    def points(self, z: int, k: int) -> HoleImages:
        """Return the images at offset ``k`` of plane ``z`` whose cutouts are completely on the sensor."""
        images, offset = self.images(z), self.offsets_px[z][k]
        moved = HoleImages(images.holes, images.moved(np.array(offset)), images.away_um, images.shift)
        return moved.only(moved.whole(self.scan.camera.sensor.shape, self.scan.cutout))

    def offsets_um(self, z: int) -> NDArray[np.float64]:
        """Return the offsets (right, down) of plane ``z`` in object space (µm), ``(frames, 2)``."""
        offsets = np.array(self.offsets_px[z]).reshape(-1, 2)
        moved: NDArray[np.float64] = offsets[:, ::-1] * self.scan.camera.step_um(self.scan.depths_um[z])
        return moved

    def stage_um(self) -> NDArray[np.float64]:
        """Return the stage coordinates (x, y, z) of all frames (µm), ``(frames, 3)`` in the order of recording.

        At zero offset, the stage is where a single source would be on the optical axis in the depth plane.
        """
        places = []
        for z, depth in enumerate(self.scan.depths_um):
            moved = self.offsets_um(z)
            places.append(np.concatenate([moved, np.full((len(moved), 1), depth)], axis=1))
        return self.scan.stage.to_stage(np.concatenate(places))

    def forecast(self, stage_um_per_s: float = 1000.0, frames_per_s: float | None = None) -> TargetForecast:
        """Predict the time for all frames with a stage that moves all axes at once at ``stage_um_per_s`` (µm/s).

        ``frames_per_s`` is the camera's highest frame rate (frames/s); if it is None, readout is not included.
        """
        check_number("stage speed (µm/s)", stage_um_per_s, above=0)
        path, scan = self.stage_um(), self.scan
        way = float(np.abs(np.diff(path, axis=0)).max(axis=1).sum()) if len(path) > 1 else 0.0
        counts = [len(plane) for plane in self.offsets_px]
        exposing = sum(n * seconds for n, seconds in zip(counts, scan.exposures, strict=True))
        frames = sum(counts) * scan.frames_averaged
        return TargetForecast(
            frames,
            exposing * scan.frames_averaged / 3600,
            sum(counts) * scan.settle_s / 3600,
            way / stage_um_per_s / 3600,
            readout_hours(frames, frames_per_s),
        )

    def single(self, stage_um_per_s: float = 1000.0) -> Forecast:
        """Return the forecast for the scan of a single point, with a stage of speed ``stage_um_per_s`` (µm/s)."""
        return Forecast.of(self.scan, stage_um_per_s=stage_um_per_s)

    # -- what is shown ---------------------------------------------------------------------------------
    def points_a_frame(self, z: int) -> tuple[int, int]:
        """Return the smallest and the largest number of complete cutouts in the frames of plane ``z``."""
        counts = [len(self.points(z, k)) for k in range(len(self.offsets_px[z]))]
        return (min(counts), max(counts)) if counts else (0, 0)

    def least_frames(self, z: int) -> int:
        """Return a lower limit for the number of frames of plane ``z``.

        The limit is the number of positions divided by the largest number of complete cutouts in a frame, rounded up.
        """
        return math.ceil(math.prod(self.scan.period) / max(1, self.points_a_frame(z)[1]))

    def shown(self, z: int, *, target: Target | None = None, tolerance_px: float | None = None) -> NDArray[np.intp]:
        """Return the number of frames that show each position of plane ``z``, ``(ny, nx)``.

        Parameters
        ----------
        z
            Index of the plane.
        target
            The target with its actual pose. None: as planned.
        tolerance_px
            Largest difference of phases in rows and in columns (px). None: that of the plan.
        """
        phases = Phases.of(self.scan)
        images = hole_images(target or self.target, self.scan.camera, self.scan.depths_um[z])
        counts = np.zeros(phases.count, np.intp)
        for offset in np.array(self.offsets_px[z]).reshape(-1, 2):
            counts[covered_by(phases, images, offset, tolerance_px or self.tolerance_px)] += 1
        return counts.reshape(self.scan.period)

    def coverage(self, z: int, *, target: Target | None = None, tolerance_px: float | None = None) -> float:
        """Return the fraction of positions of plane ``z`` that at least one frame shows; parameters as in `shown`."""
        return float((self.shown(z, target=target, tolerance_px=tolerance_px) > 0).mean())

    # -- JSON ------------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain JSON types."""
        scan = self.scan.to_dict()
        # the first lines distinguish it from a scan plan, whose format is not repeated here
        version = scan.pop("version")
        del scan["format"]
        body = {name: getattr(self, name) for name in ("offsets_px", "tolerance_px", "crosstalk", "tails")}
        target = asdict(self.target)
        if self.lit is not None:
            body["lit"] = self.lit
        return {"format": FORMAT, "version": VERSION, "scan_version": version, **body, "target": target, "scan": scan}

    def to_json(self) -> str:
        """Return the plan as JSON text."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TargetPlan:
        """Return the plan described by ``data``; raise `InputError` if its format, version or entries are invalid."""
        what = "plan of a target"
        if not isinstance(data, Mapping) or data.get("format") != FORMAT:
            raise FileFormatError.expected(
                what, f'"format": "{FORMAT}"', stated_format(data), "choose a plan made by lfcal plan target"
            )
        if data.get("version") != VERSION:
            raise FileFormatError.expected(what, f"version {VERSION}", data.get("version"), "update lfcal")
        body = {"lit": None} | {k: v for k, v in data.items() if k not in ("format", "version", "scan_version")}
        if not isinstance(body.get("scan"), Mapping):
            raise FileFormatError.expected(
                what, "a scan", type(body.get("scan")).__name__, "make the plan again with lfcal plan target"
            )
        whole = {"format": "lfcal-plan", "version": data.get("scan_version"), **body["scan"]}
        body["scan"] = ScanPlan.from_dict(whole)
        return build(cls, body, what)

    @classmethod
    def from_json(cls, text: str) -> TargetPlan:
        """Return the plan described by JSON ``text``; the errors are those of `from_dict`."""
        return cls.from_dict(parse_json(text, "plan of a target"))


def region_points(plan: TargetPlan, regions: RegionPlan, z: int) -> NDArray[np.intp]:
    """Return the number of points with complete cutouts in each frame of plane ``z`` and region, ``(frames, regions)``.

    A point belongs to the region whose middle is nearest.
    """
    scan, images = plan.scan, plan.images(z)
    middles = np.array(regions.anchors) + (np.array(scan.period) - 1) / 2
    counts = np.zeros((len(plan.offsets_px[z]), len(regions)), np.intp)
    for k, offset in enumerate(plan.offsets_px[z]):
        pixels = images.moved(np.array(offset))
        pixels = pixels[whole_at(pixels, scan.camera.sensor.shape, scan.cutout)]
        nearest = np.linalg.norm(pixels[:, None] - middles, axis=2).argmin(1)
        counts[k] = np.bincount(nearest, minlength=len(regions))
    return counts
