"""Read the result of an earlier fit, from its folder or from the fit itself, as a start for further work."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, parse_json, read_text, stated_format
from lfcal.camera import Camera, ScanPlan
from lfcal.fit.files import FORMAT, VERSION
from lfcal.fit.nuisance import Spread
from lfcal.fit.parameters import Unknown
from lfcal.fit.result import Fit
from lfcal.fit.setup import Setup
from lfcal.simulate.effects import effect_from, read_entries

__all__ = ["NAMES", "Earlier", "read_earlier"]

F8 = NDArray[np.float64]

NAMES = ("camera.json", "effects.json", "fit.json")
"""Files of a fit that describe the fitted camera and its uncertainty."""


@dataclass(frozen=True, eq=False)
class Earlier:
    """Result of an earlier fit with its uncertainty.

    Attributes
    ----------
    setup, groups
        Fitted camera, effects, depths and stage, and the groups of fitted unknowns.
    names, sigmas, correlations
        Names of the parameters, their standard deviations as in `Parameter.sigma_held`, and correlations ``(k, k)``.
    values
        Fitted values of the parameters ``(k,)``.
    spread
        Scatter of the source positions, of the brightness of the lamp, and of the response of the pixels.
    positions
        Positions ``(n, 3)`` of the patterns used, as (z, y, x), including held-out ones.
    depths_um
        Planned depths of the planes of the scan (µm).
    complete
        Whether the model explains the patterns to within their noise; otherwise, more patterns do not help.
    """

    setup: Setup
    groups: tuple[str, ...]
    names: tuple[str, ...]
    values: F8
    sigmas: F8
    correlations: F8
    spread: Spread
    positions: NDArray[np.intp]
    depths_um: tuple[float, ...]
    complete: bool

    @classmethod
    def of(cls, fit: Fit) -> Earlier:
        """Return the result of ``fit``."""
        found = list(fit.parameters.values())
        return cls(
            fit.setup,
            fit.groups,
            tuple(one.name for one in found),
            np.array([one.value for one in found]),
            np.array([one.sigma_held for one in found]),
            fit.correlations,
            fit.spread,
            np.array(list(fit.residuals), np.intp).reshape(-1, 3),
            fit.planned.depths_um,
            fit.complete,
        )

    def check_plan(self, plan: ScanPlan) -> None:
        """Raise `InputError` unless ``plan`` has the depth planes of the fit and contains all its positions."""
        if len(plan.depths_um) != len(self.depths_um) or not np.allclose(plan.depths_um, self.depths_um, rtol=1e-6):
            got = ", ".join(f"{z:g}" for z in plan.depths_um)
            wanted = ", ".join(f"{z:g}" for z in self.depths_um)
            raise InputError.expected(
                "depth planes (µm)", f"{wanted}, as in the earlier fit", got, "plan the same depth planes"
            )
        plan.in_scan_order(self.positions)

    def information(self, unknowns: Sequence[Unknown]) -> F8:
        """Return the information ``(k, k)`` that the fit provides about ``unknowns``, each in units of its scale.

        The information is zero for unknowns that were not fitted or not determined.
        """
        own, there, sigmas = self._common(unknowns)
        out = np.zeros((len(unknowns), len(unknowns)))
        if len(own):
            values, vectors = np.linalg.eigh(self.correlations[np.ix_(there, there)])
            good = values > 1e-12 * values.max()
            inverse = (vectors[:, good] / values[good]) @ vectors[:, good].T
            out[np.ix_(own, own)] = inverse / np.outer(sigmas, sigmas)
        return out

    def roots(self, unknowns: Sequence[Unknown]) -> F8:
        """Return vectors ``(m, k)`` whose outer products add up to the covariance of ``unknowns``, in their scales.

        The covariance is zero for unknowns that were not fitted or not determined.
        """
        own, there, sigmas = self._common(unknowns)
        values, vectors = np.linalg.eigh(self.correlations[np.ix_(there, there)] * np.outer(sigmas, sigmas))
        good = values > 1e-12 * values.max(initial=0.0)
        out = np.zeros((int(good.sum()), len(unknowns)))
        out[:, own] = (vectors[:, good] * np.sqrt(values[good])).T
        return out

    def _common(self, unknowns: Sequence[Unknown]) -> tuple[NDArray[np.intp], NDArray[np.intp], F8]:
        """Return the indices of fitted ``unknowns``, their indices in `names`, and their sigmas in scales."""
        places = {name: k for k, name in enumerate(self.names)}
        both = [(k, places[one.name]) for k, one in enumerate(unknowns) if one.name in places]
        sigmas = np.array([_in_scales(unknowns[a], self.sigmas[b], self.values[b]) for a, b in both])
        # an undetermined parameter has no standard deviation
        known = sigmas > 0
        pairs = np.array(both, np.intp).reshape(-1, 2)[known]
        return pairs[:, 0], pairs[:, 1], sigmas[known]


def _in_scales(unknown: Unknown, sigma: float, value: float) -> float:
    """Return a standard deviation in scales: the inverse of `Unknown.sigma_of`."""
    if not unknown.squared:
        return sigma / unknown.scale
    return max(sigma * 2 * value, sigma**2) / unknown.scale**2


def read_earlier(folder: str | os.PathLike[str]) -> Earlier:
    """Return the result of the fit in a folder that ``lfcal fit`` wrote.

    Raises
    ------
    InputError, FileFormatError
        If the folder contains no fit, or one of its files is damaged or of another version.
    """
    place = Path(folder)
    lacking = [name for name in NAMES if not (place / name).is_file()]
    if lacking:
        found = f"a folder without {lacking[0]}" if place.is_dir() else "a file" if place.exists() else "no such folder"
        raise InputError.expected(str(place), "the folder of a fit", found, "check the path, or run lfcal fit")
    path = place / "fit.json"
    data: Any = parse_json(read_text(path), str(path))
    if not isinstance(data, Mapping) or data.get("format") != FORMAT or data.get("version") != VERSION:
        wanted = f'"format": "{FORMAT}", version {VERSION}'
        raise FileFormatError.expected(str(path), wanted, stated_format(data), "run lfcal fit again")
    camera = Camera.from_json(read_text(place / "camera.json"))
    try:
        return _earlier(data, camera, place)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError):
        raise FileFormatError.expected(
            str(path), "a result of lfcal fit", "missing or damaged entries", "run lfcal fit again"
        ) from None


def _earlier(data: Mapping[str, Any], camera: Camera, place: Path) -> Earlier:
    found = data["parameters"]
    correlations = np.array(data["correlations"], np.float64)
    values = np.array([one["value"] for one in found], np.float64)
    # correlations are those with all other parameters fixed
    sigmas = np.array([one.get("sigma_held", one["sigma"]) for one in found], np.float64)
    path, again = place / "fit.json", "run lfcal fit again"
    if correlations.shape != (len(found), len(found)):
        wanted = f"correlations of {len(found)} parameters"
        raise FileFormatError.expected(str(path), wanted, f"a table of shape {correlations.shape}", again)
    if not np.isfinite([*values, *sigmas, *correlations.flat]).all():
        raise FileFormatError.expected(str(path), "finite parameters and correlations", "NaN or infinity", again)
    aside, spread = data.get("aside_px", (0.0, 0.0)), data["spread"]
    return Earlier(
        Setup(
            camera,
            # an effect without magnitudes is only a setting
            tuple(one.effect or effect_from(one.name, {}) for one in read_entries(place / "effects.json")),
            tuple(float(v) for v in data["depth_errors_um"]),
            float(data["stage_scale"]),
            (float(aside[0]), float(aside[1])),
        ),
        tuple(str(name) for name in data["groups"]),
        tuple(str(one["name"]) for one in found),
        values,
        sigmas,
        correlations,
        # fits of earlier versions do not state the response of pixels
        Spread(*(float(v) for v in (spread["stage_px"], spread["lamp"], spread.get("response", 0.0)))),
        np.array(data["positions"], np.intp).reshape(-1, 3),
        tuple(float(z) for z in data["depths_um"]),
        bool(data["complete"]),
    )
