"""Read a fit from its folder, to fill positions that a scan never recorded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    Clock,
    FileFormatError,
    InputError,
    Work,
    for_each_chunk,
    format_share,
    parse_json,
    read_text,
    stated_format,
    worker_count,
)
from lfcal.camera import Camera, ScanPlan
from lfcal.fit.field_files import FIELD
from lfcal.fit.files import FORMAT, NUMBERS, VERSION
from lfcal.fit.hybrid import model_uncertainty
from lfcal.fit.model import Fineness, PlaneModel
from lfcal.fit.problem import ERRORS
from lfcal.fit.result import Fit
from lfcal.fit.setup import Setup
from lfcal.fit.spread import spread_out
from lfcal.psf import Facts, Filled, Origin
from lfcal.simulate.effects import effect_from, read_entries

__all__ = ["Filler", "StoredFit", "numbers_file", "read_fit", "read_fits"]

F4 = NDArray[np.float32]

POSITIONS_COMPARED = 8
"""Number of recorded positions of a plane at which a fit is compared with the data."""

LARGEST_DISTANCE = 0.25
"""Relative error (L2, beyond noise) above which recorded patterns do not belong to the fit."""

OTHER_LIGHT = 0.05
"""Relative difference of the light above which patterns do not have the units of the fit."""


@dataclass(frozen=True, eq=False)
class StoredFit:
    """Contents of the folder of a fit that are needed to predict patterns.

    Attributes
    ----------
    folder
        Path of the folder.
    setup
        Fitted camera, effects and depths, with sources at the positions of H.
    depths_um, period, anchor
        Depths (µm), period and anchor (pixels) of the fitted scan.
    gains
        Gain of each plane ``(nz,)`` in the units of the data, interpolated between neighbours for planes without a
        pattern.
    error
        Relative error (L2) of the model, including the numerical error of its predictions.
    positions
        Positions (z, y, x) that were fitted, held out, or excluded with a reason.
    fitted_planes
        Indices of the planes with fitted patterns.
    stage_scale
        Relative error of the step length of the stage.
    response
        Rms variation of the pixel response, relative to its mean.
    travel_rad
        Tilt of the direction in which the stage moves the source in depth, relative to the optical axis (rad): along y
        (towards higher rows), then along x (towards higher columns).
    """

    folder: Path
    setup: Setup
    depths_um: tuple[float, ...]
    period: tuple[int, int]
    anchor: tuple[float, float]
    gains: NDArray[np.float64]
    error: float
    positions: frozenset[tuple[int, int, int]] = frozenset()
    fitted_planes: frozenset[int] = frozenset()
    stage_scale: float = 0.0
    response: float = 0.0
    travel_rad: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, fit: Fit) -> StoredFit:
        """Return the contents that the folder of ``fit`` would have, without writing it.

        `folder` is ``Path()``, and `positions` do not include outliers.
        """
        plan = fit.planned
        return cls(
            folder=Path(),
            setup=fit.ideal_places,
            depths_um=plan.depths_um,
            period=plan.period,
            anchor=plan.anchor,
            gains=fit.levels.gains,
            error=math.hypot(fit.held_out_error.value, ERRORS[Fineness.finest]),
            positions=frozenset(fit.residuals),
            fitted_planes=frozenset(z for z, _, _ in fit.residuals),
            stage_scale=fit.setup.stage_scale,
            response=fit.spread.response,
            travel_rad=fit.setup.travel_rad,
        )

    @property
    def whole_setup(self) -> Setup:
        """The setup with sources at the actual positions of the stage, instead of those of H."""
        return replace(self.setup, stage_scale=self.stage_scale, travel_rad=self.travel_rad)

    def is_of(self, plan: ScanPlan) -> bool:
        """Return whether ``plan`` has the anchor, period and depths of the fitted scan."""
        own, theirs = (self.anchor, self.period, self.depths_um), (plan.anchor, plan.period, plan.depths_um)
        return own == theirs

    def check(self, plan: ScanPlan) -> None:
        """Raise `InputError` if ``plan`` differs from the fitted scan, or resamples the pixels.

        Period, depths, anchor and size of the camera's pixels are compared.
        """
        have: dict[str, tuple[Any, Any]] = {
            "period": (self.period, plan.period),
            "depths (µm)": (self.depths_um, plan.depths_um),
            "anchor (pixels)": (self.anchor, plan.anchor),
            "pixel (µm)": (self.setup.camera.sensor.pixel_um, plan.camera.sensor.pixel_um),
        }
        for name, (own, theirs) in have.items():
            if np.shape(own) != np.shape(theirs) or not np.allclose(own, theirs, rtol=1e-6, atol=1e-6):
                raise InputError.expected(
                    f"{self.folder}, {name}",
                    f"{theirs}, as in the scan",
                    own,
                    "give the folder of the fit of this scan",
                )
        if plan.resample:
            raise InputError.expected(
                f"{self.folder}, scan",
                "a scan on the original pixels of the sensor",
                "a scan on resampled pixels",
                "do not fill missing positions from this fit (leave --fill out)",
            )


def numbers_file(folder: Path) -> Path | None:
    """Return the path of the JSON file, written last, with the results of a fit; None if there is none."""
    return next((folder / name for name in (FIELD, NUMBERS) if (folder / name).is_file()), None)


def read_fits(folder: Path) -> dict[str, StoredFit]:
    """Return the fits in a folder by the names of their regions; a fit of a single region has an empty name.

    Raises
    ------
    StorageError, FileFormatError, InputError
        If a file is missing, or has other contents.
    """
    path = numbers_file(folder)
    if path is None or path.name != FIELD:
        return {"": read_fit(folder)}
    found = parse_json(read_text(path), str(path), remedy="run lfcal fit again")
    regions = found.get("regions") if isinstance(found, dict) else None
    listed = regions if isinstance(regions, list) else []
    names = [str(one["name"]) for one in listed if isinstance(one, dict) and "name" in one]
    # a file from elsewhere must not refer to paths outside its folder
    if not names or not all(Path(name).name == name for name in names):
        raise FileFormatError.expected(
            str(path), "a fit of several regions", f"regions {names}" if names else "no regions", "run lfcal fit again"
        )
    return {name: read_fit(folder / name) for name in names}


def read_fit(folder: Path) -> StoredFit:
    """Return the fit in a folder that ``lfcal fit`` wrote.

    Raises
    ------
    StorageError, FileFormatError, InputError
        If a file is missing, or has other contents.
    """
    path = folder / "fit.json"
    again = "run lfcal fit again"
    found = parse_json(read_text(path), str(path), remedy=again)
    if not isinstance(found, dict) or found.get("format") != FORMAT or found.get("version") != VERSION:
        raise FileFormatError.expected(
            str(path), f'"format": "{FORMAT}", version {VERSION}', stated_format(found), again
        )
    if "scan" not in found:
        raise FileFormatError.expected(
            str(path), "the scan that was fitted", "a result of an older version of lfcal", again
        )
    camera = Camera.from_json(read_text(folder / "camera.json"))
    # effects without magnitudes are stored as switched on
    given = tuple(entry.effect or effect_from(entry.name, {}) for entry in read_entries(folder / "effects.json"))
    try:
        rows, columns = (float(v) for v in found.get("aside_px", (0.0, 0.0)))
        depth_errors = tuple(float(v) for v in found["depth_errors_um"])
        down, right = (float(v) for v in found.get("travel_rad", (0.0, 0.0)))
        setup = Setup(camera, given, depth_errors, aside_px=(rows, columns))
        gains = np.array([float(v) for v in found["gains"]])
        fitted = frozenset(_position(at) for at in found["positions"])
        outliers = frozenset(_position((one["z"], one["y"], one["x"])) for one in found.get("outliers", ()))
        depths = tuple(float(v) for v in found["depths_um"])
        period, anchor = (tuple(found["scan"][name]) for name in ("period", "anchor"))
        error = float(found["left_out_error"]["value"])
        scale, response = float(found.get("stage_scale", 0.0)), float(found.get("spread", {}).get("response", 0.0))
        good = (
            len(gains) == len(depths) == len(setup.depth_errors_um)
            and np.isfinite([*gains, *depths, error, rows, columns, scale, response, down, right]).all()
        )
        (ny, nx), (row, column) = (int(v) for v in period), (float(v) for v in anchor)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        good = False
    if not good:
        raise FileFormatError.expected(str(path), "the results of a fit", "other contents", again)
    return StoredFit(
        folder=folder,
        setup=setup,
        depths_um=depths,
        period=(ny, nx),
        anchor=(row, column),
        gains=gains,
        error=math.hypot(error, ERRORS[Fineness.finest]),
        positions=fitted | outliers,
        fitted_planes=frozenset(z for z, _, _ in fitted),
        stage_scale=scale,
        response=response,
        travel_rad=(down, right),
    )


def _position(at: Any) -> tuple[int, int, int]:
    z, y, x = (int(v) for v in at)
    return z, y, x


class Filler:
    """Callable that fills the missing positions of assembled planes with predictions of a fit.

    Parameters
    ----------
    fit
        The fit of the scan.
    plan
        The scan that is assembled.
    workers
        Number of threads. None: all processors.

    Raises
    ------
    InputError
        If the fit is that of another scan, or the scan resamples the pixels.
    """

    def __init__(self, fit: StoredFit, plan: ScanPlan, workers: int | None = None) -> None:
        fit.check(plan)
        self._fit, self._plan, self._workers = fit, plan, worker_count(workers)

    @property
    def provenance(self) -> dict[str, Any]:
        """Folder name, error and camera of the fit that fills the positions, for the provenance of H."""
        return {"fit": self._fit.folder.name, "error": self._fit.error, "camera": self._fit.setup.camera.to_dict()}

    def __call__(self, z: int, values: F4, facts: Facts) -> Work[Filled]:
        """Fill plane ``z`` ``(ny, nx, nt, ns)`` in place where nothing was recorded; progress counts positions.

        Raises
        ------
        InputError
            If recorded patterns are not those that the fit predicts, or no pattern of the plane was fitted.
        """
        assert facts.recorded is not None
        missing = np.argwhere(facts.recorded == 0)
        if not len(missing):
            return Filled(facts, None)
        gain = self._fit.gains[z]
        if z not in self._fit.fitted_planes:
            raise InputError.expected(
                f"{self._fit.folder}, plane {z}",
                "at least one fitted pattern",
                "none",
                "fit at least one pattern of each plane",
            )
        plan = replace(self._plan, camera=self._fit.setup.camera, cutout=(values.shape[2], values.shape[3]))
        model = PlaneModel(self._fit.setup, plan, z, Fineness.finest)
        self._compare(z, model, values, facts)
        clock = Clock(f"fill plane {z}", len(missing))
        yield clock.at(0)
        step = 8 * self._workers

        def some(start: int, stop: int) -> None:
            at = missing[start:stop]
            values[at[:, 0], at[:, 1]] = np.float32(gain) * model.patterns(at, np.zeros((len(at), 2)))

        for first in range(0, len(missing), step):
            last = min(len(missing), first + step)
            for_each_chunk(lambda a, b, at=first: some(at + a, at + b), last - first, self._workers)  # type: ignore[misc]
            yield clock.at(last)
        rows, columns = missing.T
        origin = np.zeros(facts.recorded.shape, np.uint8)
        origin[rows, columns] = Origin.MODEL
        spread = np.zeros_like(values)
        spread[rows, columns] = model_uncertainty(values[rows, columns][None], self._fit.error)[0]
        known: Mapping[str, Any] = facts.known()
        return Filled(Facts.of(origin.shape, plan.cutout, **{**known, "origin": origin}), spread)

    def _compare(self, z: int, model: PlaneModel, values: F4, facts: Facts) -> None:
        """Raise `InputError` if the recorded patterns are not those of the fit."""
        assert facts.recorded is not None
        there = np.argwhere(facts.recorded > 0)
        if not len(there):
            return
        some = there[
            spread_out(
                np.c_[np.zeros(len(there), np.intp), there], min(POSITIONS_COMPARED, len(there)), self._plan.period
            )
        ]
        light = self._fit.gains[z] * model.patterns(some, np.zeros((len(some), 2))).astype(np.float64)
        data = values[some[:, 0], some[:, 1]].astype(np.float64)
        # a background is not light of the point
        light0, data0 = (one - one.mean((1, 2), keepdims=True) for one in (light, data))
        scale = float((light0 * data0).sum() / np.square(light0).sum())
        left = float(np.square(data0 - scale * light0).sum())
        if facts.noise is not None and np.isfinite(noise := facts.noise[some[:, 0], some[:, 1]]).all():
            left -= float((noise[:, 0, None, None] + noise[:, 1, None, None] * np.maximum(light, 0)).sum())
        far = math.sqrt(max(0.0, left) / float(np.square(data0).sum()))
        if scale <= 0 or far > LARGEST_DISTANCE:
            raise InputError.expected(
                f"{self._fit.folder}",
                f"the fit of the camera that recorded plane {z}",
                f"predictions with an error of {format_share(far)}"
                if scale > 0
                else "predictions that do not resemble it",
                "fit these frames",
            )
        if abs(scale - 1.0) > OTHER_LIGHT:
            raise InputError.expected(
                f"{self._fit.folder}",
                f"as much light as in the frames of plane {z}",
                f"{format_share(1 / scale)} of it",
                "fit these frames, with the same corrections as for their assembly",
            )
