"""Images and numbers of Set up: the sensor with the scan, the planes, and the costs. No Qt."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import drain, format_bytes, format_count, format_length, format_seconds, format_share
from lfcal.camera import Camera, Forecast, PupilLenslets, ScanPlan, not_stated_for_noise
from lfcal_gui.models import CUTOUT, Outline, Overlay, Shot, cutout_of
from lfcal_gui.pages.setup.model_scan import scan_path
from lfcal_gui.pages.setup.model_target import PlanSettings

if TYPE_CHECKING:
    from lfcal.psf.aperture import Aperture
    from lfcal.simulate import ExpectedLight, ScanChoice
    from lfcal_gui.pages.setup.model_check import Checked

MOST = 480
"""Number of samples along the longer side of a drawn lattice."""
FINEST = 3.0
"""Smallest number of samples per pitch; smaller lenslets are not drawn."""
CENTRES = 3000
"""Largest number of visible lenslets for which centres are drawn; more would cover the image."""
LENSLETS = 24
"""Number of lenslets shown along a side if there is no plan."""
DARK, LIT, SHADE = 0.08, 0.36, 0.12
"""Brightness (0 to 1) between and within lenslets, and its decrease towards their edges."""

Area = tuple[float, float, float, float]
"""First row and column, height and width (px)."""


@dataclass(frozen=True, eq=False)
class ScanScene:
    """A camera with its scan plan and its white image.

    Attributes
    ----------
    camera, plan
        Camera and plan.
    half
        Recorded positions ``(n, 3)``. None: all.
    checked
        White image with its fitted lattice; None if there is none.
    """

    camera: Camera
    plan: ScanPlan | None = None
    half: NDArray[np.intp] | None = None
    checked: Checked | None = None

    def same_view(self, other: ScanScene | None) -> bool:
        """Return whether both scenes have the same view, except for the position of the scan."""
        if other is None or self.camera != other.camera or self.checked is not other.checked:
            return False
        if self.plan is None or other.plan is None:
            return self.plan is other.plan
        return self.plan.period == other.plan.period and self.plan.cutout == other.plan.cutout

    @property
    def lattice(self) -> Camera:
        """Camera whose lattice is drawn: the measured one if there is one."""
        measured = None if self.checked is None else self.checked.check.camera
        return measured or self.camera

    @property
    def cutout(self) -> Area | None:
        """Cutout around the middle of the scan."""
        plan = self.plan
        if plan is None:
            return None
        middle = [a + (n - 1) // 2 for a, n in zip(plan.anchor, plan.period, strict=True)]
        row, column = (m - (n - 1) // 2 for m, n in zip(middle, plan.cutout, strict=True))
        return row, column, plan.cutout[0], plan.cutout[1]

    @property
    def counted(self) -> Area | None:
        """Area of the pixels in any cutout of the scan."""
        plan = self.plan
        if plan is None:
            return None
        row, column = (a - (n - 1) // 2 for a, n in zip(plan.anchor, plan.cutout, strict=True))
        height, width = (p + n - 1 for p, n in zip(plan.period, plan.cutout, strict=True))
        return row, column, height, width

    def area(self) -> Area:
        """Return the initial view: the scan with a margin, or the middle of the sensor."""
        rows, columns = self.camera.sensor.shape
        counted = self.counted
        if counted is not None:
            row, column, height, width = counted
            room = 0.3 * max(height, width)
            return row - room, column - room, height + 2 * room, width + 2 * room
        side = LENSLETS * self.camera.pitch_px if self.camera.has_lattice else math.inf
        height, width = min(float(rows), side), min(float(columns), 1.5 * side)
        return (rows - height) / 2, (columns - width) / 2, height, width

    def shot(self, view: Area) -> Shot:
        """Return the white image, or a drawing of the lattice in ``view``."""
        if self.checked is not None and self.checked.whole:
            return Shot(
                self.checked.picture,
                f"White image {self.checked.name}",
                name="white",
                step=self.checked.step,
                pixel_um=self.camera.sensor.pixel_um * self.checked.step,
            )
        row, column, height, width = view
        step = max(height, width) / MOST
        rows, columns = (
            _on_sensor(start + step * np.arange(max(2, round(n / step))), side)
            for start, n, side in zip((row, column), (height, width), self.camera.sensor.shape, strict=True)
        )
        values = _drawn(self.camera, rows, columns, step)
        return Shot(
            values,
            "Lattice as described",
            name="lattice",
            levels=(0.0, 1.0),
            origin=(float(rows[0]), float(columns[0])),
            step=step,
            pixel_um=self.camera.sensor.pixel_um * step,
        )

    def centres(self, view: Area) -> Camera | None:
        """Return the camera whose lenslet centres are drawn in ``view``; None if there are too many."""
        camera = self.lattice
        few = not camera.has_lattice or view[2] * view[3] < CENTRES * camera.pitch_px**2
        return camera if few else None

    def scan_overlays(self) -> tuple[Overlay, ...]:
        """Return the path of the scan and its border."""
        plan = self.plan
        if plan is None:
            return ()
        path = scan_path(plan, self.half)
        (border,) = cutout_of(*plan.anchor, plan.period, colour="#ffffff")
        return Outline(path, "#b0ffffff", closed=False, width=0.8), border

    def cutout_overlays(self) -> tuple[Overlay, ...]:
        """Return the cutout in the middle of the scan, and the dashed area of all cutouts."""
        if self.cutout is None or self.counted is None:
            return ()
        (middle,) = cutout_of(*self.cutout[:2], (round(self.cutout[2]), round(self.cutout[3])))
        (all_of_it,) = cutout_of(*self.counted[:2], (round(self.counted[2]), round(self.counted[3])))
        assert isinstance(all_of_it, Outline)
        return middle, replace(all_of_it, colour=CUTOUT, dashed=True, width=1.2)

    def aperture_overlays(self, aperture: Aperture | None, colour: str) -> tuple[Overlay, ...]:
        """Return the outline of an aperture in the cutout."""
        if self.cutout is None or aperture is None:
            return ()
        return (Outline(aperture.outline() + np.array(self.cutout[:2]), colour, dashed=True),)

    def sensor_overlay(self) -> Overlay:
        """Return the border of the sensor."""
        (border,) = cutout_of(0, 0, self.camera.sensor.shape, colour="#8090a0")
        return border


def _on_sensor(places: NDArray[Any], side: int) -> NDArray[np.float64]:
    """Return the positions that are on a sensor with ``side`` pixels, or one outside if there are none."""
    inside: NDArray[np.float64] = places[(places >= -0.5) & (places <= side - 0.5)]
    return inside if inside.size else places[:1]


def _drawn(camera: Camera, rows: NDArray[Any], columns: NDArray[Any], step: float) -> NDArray[np.float32]:
    """Return an image of the lenslets, as discs or as squares without gaps, at sensor rows and columns."""
    lattice = camera.lattice
    values = np.full((rows.size, columns.size), DARK, np.float32)
    blur_um = step * camera.sensor.pixel_um
    if isinstance(lattice, PupilLenslets):
        radius = min(lattice.spacing_um, lattice.clear_um) / 2
        x = camera.sensor_um(np.stack(np.broadcast_arrays(rows[0], columns), axis=-1))[:, 0]
        y = camera.sensor_um(np.stack(np.broadcast_arrays(rows, columns[0]), axis=-1))[:, 1]
        for across, up in np.array(lattice.lens_centres_um) + np.array(lattice.offset_um):
            near = (np.flatnonzero(np.abs(axis - at) < radius + blur_um) for axis, at in ((y, up), (x, across)))
            part = np.ix_(*near)
            reach = np.hypot(y[part[0]] - up, x[part[1]] - across)
            lit = np.clip((radius - reach) / blur_um + 0.5, 0, 1)
            values[part] = np.maximum(values[part], DARK + (LIT - DARK - SHADE * (reach / radius) ** 4) * lit)
        return values
    if camera.pitch_px >= FINEST * step:
        xy = camera.sensor_um(np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1))
        index = lattice.lenslet_at(xy)
        within, basis = (index - np.floor(index)).astype(np.float32), lattice.basis_um().astype(np.float32)
        x, y = (within[..., 0] * basis[0, k] + within[..., 1] * basis[1, k] for k in range(2))
        # the nearest lenslet is at one of the corners of the cell; squares are much faster than np.hypot
        squared = np.full(x.shape, np.inf, np.float32)
        for across, up in np.array(((0, 0), (0, 1), (1, 0), (1, 1)), np.float32) @ basis:
            x2, y2 = (x - across) ** 2, (y - up) ** 2
            np.minimum(squared, np.maximum(x2, y2) if lattice.edge_to_edge else x2 + y2, out=squared)
        radius = lattice.clear_diameter_um / 2
        # brighter in the middle, so that neighbours that touch are distinguished; edges are one sample wide
        lit = np.clip((radius - np.sqrt(squared)) / blur_um + 0.5, 0, 1)
        out = np.minimum(squared / max(radius, 1e-6) ** 2, 1)  # an aperture may be described as a point
        values = (DARK + (LIT - DARK - SHADE * out**2) * lit).astype(np.float32)
    return values


def light_key(plan: ScanPlan) -> tuple[Any, ...]:
    """Return everything on which the light of the patterns depends, as a key."""
    return plan.camera, plan.period, plan.cutout, plan.depths_um, plan.resample


def expected_light(plan: ScanPlan) -> ExpectedLight:
    """Return the expected brightness of the pixels of the patterns; takes seconds."""
    from lfcal.simulate import iter_expected_light

    return drain(iter_expected_light(plan))


@dataclass(frozen=True, eq=False)
class ScanCosts:
    """Forecast time, bytes and noise of a plan.

    Attributes
    ----------
    plan, settings, half
        Scan plan, settings, and recorded positions ``(n, 3)`` (None: all).
    forecast
        Time and bytes.
    choices
        Ways to record the scan, fastest first; empty if the noise is unknown.
    unknown
        Why the noise is unknown; empty if it is known or still being computed.
    """

    plan: ScanPlan
    settings: PlanSettings
    half: NDArray[np.intp] | None
    forecast: Forecast
    choices: tuple[ScanChoice, ...] = ()
    unknown: str = ""

    @classmethod
    def of(
        cls, plan: ScanPlan, settings: PlanSettings, half: NDArray[np.intp] | None, light: ExpectedLight | str | None
    ) -> ScanCosts:
        """Return the costs of a plan, with its noise if the light of its patterns is known.

        ``light`` may be the reason why it is unknown; None: it is being computed.
        """
        forecast = Forecast.of(plan, **settings.forecast_keywords(), positions=half)
        unknown = _unknown(plan, settings) or (light if isinstance(light, str) else "")
        if isinstance(light, str) or unknown or light is None or settings.peak is None:
            return cls(plan, settings, half, forecast, unknown=unknown)
        from lfcal.simulate import scan_choices

        return cls(plan, settings, half, forecast, scan_choices(plan, light, settings.peak, forecast))

    @property
    def own(self) -> int:
        """Index of the choice that matches the plan; -1 if there are no choices."""
        return next((k for k, one in enumerate(self.choices) if one.plan is self.plan), -1)

    @property
    def way(self) -> str:
        """Frames and exposure per position, such as ``4 frames of 20 ms``."""
        frames, exposures = self.plan.frames_averaged, sorted(set(self.plan.exposures))
        times = " … ".join(format_seconds(one) for one in dict.fromkeys((exposures[0], exposures[-1])))
        return f"{format_count(frames, 'frame', 'frames')} of {times}"

    def rows(self) -> list[tuple[str, str]]:
        """Return the forecast as pairs of name and value with unit."""
        plan, found = self.plan, self.forecast
        half = "" if self.half is None else f" of {plan.n_positions:,} (half cell)"
        (ry, rx), (ny, nx), readout = plan.period_residual_px, plan.period, found.readout_hours
        noise = [] if self.own < 0 else [("Expected noise of H", format_share(self.choices[self.own].noise))]
        return [
            ("Planes × rows × columns", f"{len(plan.depths_um)} × {ny} × {nx}"),
            ("Positions", f"{found.positions:,}{half}"),
            ("Frames", f"{found.frames:,}"),
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
    missing = not_stated_for_noise(plan.camera)
    if missing:
        return f"{' and '.join(missing)} only assumed"
    return "" if settings.peak is not None else "brightest pixel not planned"


@dataclass(frozen=True)
class Number:
    """A large displayed number with its unit and its meaning."""

    value: str
    unit: str
    words: str

    @classmethod
    def of(cls, text: str, words: str) -> Number:
        """Return the number of a text such as ``1.2 GB``."""
        value, _, unit = text.partition(" ")
        return cls(value, unit, words)


def numbers_of(costs: ScanCosts | None, checked: Checked | None) -> tuple[Number, ...]:
    """Return time, bytes and noise of the scan, and the residual of the measured lattice or else of the period."""
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
        found.append(Number.of(f"{checked.check.fit.residual_rms_px:.2f} px", "lattice residual, rms"))
    elif costs is not None:
        residual = max(map(abs, costs.plan.period_residual_px))
        found.append(Number.of(f"{residual:.2f} px", "period residual"))
    return tuple(found)


def _noise(costs: ScanCosts) -> Number:
    if costs.unknown:
        return Number("-", "noise of H", costs.unknown)
    if costs.own < 0:
        return Number("…", "noise of H", "computing")
    return Number.of(format_share(costs.choices[costs.own].noise), "expected noise of H")
