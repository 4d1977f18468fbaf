"""Result of the inspection of an H without a camera: all metrics, ranked, and the positions to record again."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Merit, format_count, format_length, format_plane
from lfcal.judge.quality._periodicity import Periodicity
from lfcal.judge.quality.metric import Metric
from lfcal.judge.quality.verdict import counted
from lfcal.judge.source import judgement_of
from lfcal.psf.aperture import Aperture, FNumber, Iris

__all__ = ["QualityReport"]


@dataclass(frozen=True, slots=True, eq=False)
class QualityReport:
    """Metrics of H, measured without a model of the camera.

    Attributes
    ----------
    shape
        Shape ``(nz, ny, nx, nt, ns)`` of H.
    depths
        Depth of each plane (µm), ``(nz,)``; NaN if H states none.
    metrics
        All metrics, sorted by rating with the bad ones first, then by decreasing cost.
    apertures
        The aperture measured from the patterns of each plane.
    virtual_depths
        Virtual depth of each plane, ``(nz,)``, from the size of the shadow of the iris or, if this is unknown, from the
        spacing of the spots; NaN if it cannot be measured.
    iris
        The iris, measured from all planes together; None if no plane shows it.
    f_number
        Working f-number from the slope of the aperture diameter over depth; None if camera and planes do not determine
        it.
    noise, peak, energy
        Noise of a dark pixel, median peak of the patterns, and median energy of the patterns in each plane, ``(nz,)``
        in the unit of H.
    tilings
        Result of the control frames of each plane; None for a plane without control frames.
    seconds
        Duration of the inspection (s).

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix
    >>> from lfcal.judge import QualityReport, inspect
    >>> H = np.zeros((1, 3, 3, 9, 9))
    >>> H[..., 3:6, 3:6] = np.arange(100, 109).reshape(1, 3, 3, 1, 1)
    >>> H[0, 0, 1] = 0  # a frame without light
    >>> quality: QualityReport = inspect(PSFMatrix(H))
    >>> print(quality.merit, quality.redo())
    bad [((0, 0, 1), 'missing frames')]
    """

    data: ClassVar[str] = "H"

    shape: tuple[int, int, int, int, int]
    depths: NDArray[np.float64]
    metrics: tuple[Metric, ...]
    apertures: tuple[Aperture, ...]
    virtual_depths: NDArray[np.float64]
    iris: Iris | None
    f_number: FNumber | None
    noise: NDArray[np.float64]
    peak: NDArray[np.float64]
    energy: NDArray[np.float64]
    tilings: tuple[Periodicity | None, ...]
    seconds: float

    def __getitem__(self, key: str) -> Metric:
        """Return the metric named ``key``."""
        for metric in self.metrics:
            if metric.key == key:
                return metric
        raise KeyError(key)

    def plane_words(self, z: int, name: str = "") -> str:
        """Return text with the depth of plane ``z``, or its index if H states no depth; ``name`` precedes the value."""
        return format_plane(float(self.depths[z]), z, name)

    @property
    def extent(self) -> str:
        """Text with the depths of the first and the last plane; empty if H states no depths."""
        if not np.isfinite(self.depths).all():
            return ""
        ends = (self.depths[0], self.depths[-1])[: min(2, self.depths.size)]
        return " to ".join(format_length(float(v)) for v in ends)

    @property
    def alarms(self) -> tuple[Metric, ...]:
        """The metrics rated bad, in order of decreasing cost."""
        return tuple(m for m in self.metrics if m.merit == "bad")

    @property
    def merit(self) -> Merit:
        """Rating of H according to its metrics: "good", "fair", "bad" or "unknown"."""
        return judgement_of(self).merit

    @property
    def cost(self) -> float:
        """Estimated reconstruction error (NRMSE) due to all metrics with a known value together."""
        return math.sqrt(sum(m.cost**2 for m in self.metrics if m.merit != "unknown"))

    @property
    def standing(self) -> tuple[Metric, ...]:
        """All metrics, because none is refuted without a comparison with a camera."""
        return self.metrics

    @property
    def known(self) -> str:
        """Text with the number of good metrics, for a verdict; empty if there are none."""
        good = sum(m.merit == "good" for m in self.metrics)
        by = f"good by {format_count(good, 'check', 'checks')}; it was not compared with a camera"
        return by if good else ""

    @property
    def verdict(self) -> str:
        """Text with the rating of H, and the positions, cost and remedy of each problem."""
        return judgement_of(self).verdict

    def redo(self, without: Collection[str] = ()) -> list[tuple[tuple[int, int, int], str]]:
        """Return the positions (z, y, x) to record again, each with the reasons as text, sorted by position.

        ``without`` contains the keys of metrics to ignore.
        """
        reasons: dict[tuple[int, int, int], list[str]] = {}
        for metric in self.metrics:
            # checking a suspicion costs one frame, missing a fault costs a reconstruction
            if metric.spec.redo and metric.merit in ("bad", "fair") and metric.key not in without:
                for z, y, x in metric.positions.tolist():
                    reasons.setdefault((z, y, x), []).append(metric.spec.title.lower())
        return [(place, ", ".join(reasons[place])) for place in sorted(reasons)]

    def to_dict(self, *, every: bool = False) -> dict[str, object]:
        """Return metrics, planes, findings and the positions to record again as plain JSON types, without maps.

        With ``every``, metrics that do not apply are included.
        """
        return {
            "format": "lfcal-quality",
            "version": 1,
            "shape": list(self.shape),
            "cost": self.cost,
            "counts": counted(self.metrics),
            "metrics": [m.to_dict() for m in self.metrics if every or m.applies],
            "planes": [self._plane(z) for z in range(self.shape[0])],
            "iris": self.iris,
            "working_f_number": self.f_number,
            "redo": [list(place) for place, _ in self.redo()],
            "seconds": self.seconds,
            **judgement_of(self).to_dict(),
        }

    def _plane(self, z: int) -> dict[str, object]:
        return {
            "depth_um": float(self.depths[z]) if math.isfinite(self.depths[z]) else None,
            "virtual_depth": float(self.virtual_depths[z]),
            "noise": float(self.noise[z]),
            "peak": float(self.peak[z]),
            "energy": float(self.energy[z]),
            "aperture": self.apertures[z],
        }
