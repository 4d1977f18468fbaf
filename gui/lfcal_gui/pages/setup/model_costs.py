"""What a scan costs and which noise it leaves in H: big numbers, rows of the forecast, choices of a slider. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import drain, format_bytes, format_count, format_length, format_seconds, format_share
from lfcal.camera import Forecast, ScanPlan, not_stated_for_noise
from lfcal_gui.pages.setup.model_check import Checked
from lfcal_gui.pages.setup.model_target import PlanSettings

if TYPE_CHECKING:
    from lfcal.simulate import ExpectedLight, ScanChoice


def light_key(plan: ScanPlan) -> tuple[Any, ...]:
    """Return what the light of the patterns depends on."""
    return plan.camera, plan.period, plan.cutout, plan.depths_um, plan.resample


def expected_light(plan: ScanPlan) -> ExpectedLight:
    """Return how bright the pixels of the patterns are; it takes seconds."""
    from lfcal.simulate import iter_expected_light

    return drain(iter_expected_light(plan))


@dataclass(frozen=True, eq=False)
class ScanCosts:
    """Time, bytes and noise of a plan.

    Attributes
    ----------
    plan, settings, half
        The scan, its settings, and the positions ``(n, 3)`` that are recorded; None: all.
    forecast
        Time and bytes.
    choices
        Ways to record it, the fastest first; empty where the noise is not known.
    unknown
        Why it is not known; empty where it is known, or still computed.
    """

    plan: ScanPlan
    settings: PlanSettings
    half: NDArray[np.intp] | None
    forecast: Forecast
    choices: tuple[ScanChoice, ...] = ()
    unknown: str = ""

    @classmethod
    def of(
        cls, plan: ScanPlan, settings: PlanSettings, half: NDArray[np.intp] | None, light: ExpectedLight | None
    ) -> ScanCosts:
        """Return the costs of a plan, with its noise where the light of its patterns is known."""
        speed, rate = settings.speed, settings.frame_rate
        forecast = Forecast.of(plan, stage_um_per_s=speed, frames_per_s=rate, positions=half)
        unknown = _unknown(plan, settings)
        if unknown or light is None or settings.peak is None:
            return cls(plan, settings, half, forecast, unknown=unknown)
        from lfcal.simulate import scan_choices

        return cls(plan, settings, half, forecast, scan_choices(plan, light, settings.peak, forecast))

    @property
    def own(self) -> int:
        """Number of the choice that the plan is; -1: there are none."""
        return next((k for k, one in enumerate(self.choices) if one.plan is self.plan), -1)

    @property
    def way(self) -> str:
        """How a position is recorded, such as ``4 frames of 20 ms``."""
        frames, exposures = self.plan.frames_averaged, sorted(set(self.plan.exposures))
        times = " … ".join(format_seconds(one) for one in dict.fromkeys((exposures[0], exposures[-1])))
        return f"{format_count(frames, 'frame', 'frames')} of {times}"

    def rows(self) -> list[tuple[str, str]]:
        """Return the forecast as pairs of name and value with unit."""
        plan, found = self.plan, self.forecast
        half = "" if self.half is None else f" of {plan.n_positions} (half cell)"
        (ry, rx), (ny, nx), readout = plan.period_residual_px, plan.period, found.readout_hours
        noise = [] if self.own < 0 else [("Expected noise of H", format_share(self.choices[self.own].noise))]
        return [
            ("Planes × rows × columns", f"{len(plan.depths_um)} × {ny} × {nx}"),
            ("Positions", f"{found.positions}{half}"),
            ("Frames", f"{found.frames}"),
            ("Time without readout" if readout is None else "Time", format_seconds(found.hours * 3600)),
            ("  whole frames at", f"{format_bytes(found.bytes_per_s)}/s"),
            ("  exposing", format_seconds(found.exposure_hours * 3600)),
            *([] if readout is None else [("  reading out", format_seconds(readout * 3600))]),
            ("  settling", format_seconds(found.settle_hours * 3600)),
            (f"  moving at {format_length(self.settings.speed)}/s", format_seconds(found.move_hours * 3600)),
            *noise,
            ("Whole frames on disk", format_bytes(found.frame_bytes)),
            ("Cutouts on disk", format_bytes(found.cutout_bytes)),
            ("H, float32", format_bytes(found.h_float32_bytes)),
            ("H, rounded, at most", format_bytes(found.h_rounded_bytes)),
            ("HT if exported", format_bytes(found.ht_float32_bytes)),
            ("Memory to assemble", format_bytes(found.assembly_bytes)),
            ("Lateral step, first plane", format_length(plan.step_um(0)[1])),
            ("Lateral step, last plane", format_length(plan.step_um(len(plan.depths_um) - 1)[1])),
            ("Period residual, x", f"{round(rx, 3) + 0.0:+.3f} px"),
            ("Period residual, y", f"{round(ry, 3) + 0.0:+.3f} px"),
        ]


def _unknown(plan: ScanPlan, settings: PlanSettings) -> str:
    """Return why the noise of H cannot be forecast; empty: it can."""
    missing = not_stated_for_noise(plan.camera)
    if missing:
        return f"{' and '.join(missing)} only assumed"
    return "" if settings.peak is not None else "brightest pixel not planned"


@dataclass(frozen=True)
class Number:
    """A big number: its value, its unit, and what it is."""

    value: str
    unit: str
    words: str

    @classmethod
    def of(cls, text: str, words: str) -> Number:
        """Return the number of a text such as ``1.2 GB``."""
        value, _, unit = text.partition(" ")
        return cls(value, unit, words)


def numbers_of(costs: ScanCosts | None, checked: Checked | None) -> tuple[Number, ...]:
    """Return what the scan costs, its noise, and how far the lattice is off."""
    found = []
    if costs is not None:
        forecast = costs.forecast
        positions = f"{forecast.positions:,} positions"
        size = f"frames; H {format_bytes(forecast.h_float32_bytes)}"
        found = [
            Number.of(format_seconds(3600 * forecast.hours), positions),
            Number.of(format_bytes(forecast.frame_bytes), size),
            _noise(costs),
        ]
    if checked is not None and checked.check.fit is not None:
        found.append(Number.of(f"{checked.check.fit.residual_rms_px:.2f} px", "lattice off by, rms"))
    elif costs is not None:
        residual = max(map(abs, costs.plan.period_residual_px))
        found.append(Number.of(f"{residual:.2f} px", "period off lattice"))
    return tuple(found)


def _noise(costs: ScanCosts) -> Number:
    if costs.unknown:
        return Number("-", "noise of H", costs.unknown)
    if costs.own < 0:
        return Number("…", "", "expected noise of H")
    return Number.of(format_share(costs.choices[costs.own].noise), "expected noise of H")
