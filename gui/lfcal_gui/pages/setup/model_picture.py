"""What the place shows of camera and plan: the sensor with the scan on it, and the planes. No Qt."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, ScanPlan
from lfcal_gui.models import CUTOUT, Outline, Overlay, Shot, cutout_of
from lfcal_gui.pages.setup.model_check import Checked
from lfcal_gui.pages.setup.model_scan import scan_path

if TYPE_CHECKING:
    from lfcal.psf.aperture import Aperture

MOST = 480
"""Samples along the longer side of a drawn lattice."""
FINEST = 3.0
"""Samples of a pitch; lenslets that are smaller are not drawn."""
CENTRES = 3000
"""Number of lenslets in view above which no centres are drawn: they would cover the picture."""
LENSLETS = 24
"""Lenslets seen along a side where nothing is planned."""
DARK, LIT, SHADE = 0.08, 0.36, 0.12
"""Values between and within lenslets, of 1, and by how much less at their edges."""

Area = tuple[float, float, float, float]
"""First row and column, height and width (px)."""


@dataclass(frozen=True, eq=False)
class ScanScene:
    """A camera, with the scan that is planned for it, and its white image.

    Attributes
    ----------
    camera, plan
        What is described.
    half
        Positions ``(n, 3)`` that are recorded; None: all.
    checked
        The white image with the lattice in it.
    """

    camera: Camera
    plan: ScanPlan | None = None
    half: NDArray[np.intp] | None = None
    checked: Checked | None = None

    def same_view(self, other: ScanScene | None) -> bool:
        """Return whether both are looked at in the same way, wherever the scan is."""
        if other is None or self.camera != other.camera or self.checked is not other.checked:
            return False
        if self.plan is None or other.plan is None:
            return self.plan is other.plan
        return self.plan.period == other.plan.period and self.plan.cutout == other.plan.cutout

    @property
    def lattice(self) -> Camera:
        """The camera whose lattice is drawn: as measured, where it was."""
        measured = None if self.checked is None else self.checked.check.camera
        return measured or self.camera

    @property
    def cutout(self) -> Area | None:
        """The cutout about the middle of the scan."""
        plan = self.plan
        if plan is None:
            return None
        middle = [a + (n - 1) // 2 for a, n in zip(plan.anchor, plan.period, strict=True)]
        row, column = (m - (n - 1) // 2 for m, n in zip(middle, plan.cutout, strict=True))
        return row, column, plan.cutout[0], plan.cutout[1]

    @property
    def counted(self) -> Area | None:
        """All pixels that some cutout of the scan has."""
        plan = self.plan
        if plan is None:
            return None
        row, column = (a - (n - 1) // 2 for a, n in zip(plan.anchor, plan.cutout, strict=True))
        height, width = (p + n - 1 for p, n in zip(plan.period, plan.cutout, strict=True))
        return row, column, height, width

    def area(self) -> Area:
        """Return the area that is shown first: the scan with some room, or the middle of the sensor."""
        rows, columns = self.camera.sensor.shape
        counted = self.counted
        if counted is not None:
            row, column, height, width = counted
            room = 0.3 * max(height, width)
            return row - room, column - room, height + 2 * room, width + 2 * room
        side = LENSLETS * self.camera.pitch_px
        height, width = min(float(rows), side), min(float(columns), 1.5 * side)
        return (rows - height) / 2, (columns - width) / 2, height, width

    def shot(self, view: Area) -> Shot:
        """Return the white image, or the lattice drawn in ``view``."""
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
        """Return the camera whose centres of lenslets are drawn in ``view``; None: there are too many."""
        camera = self.lattice
        return camera if view[2] * view[3] < CENTRES * camera.pitch_px**2 else None

    def scan_overlays(self) -> tuple[Overlay, ...]:
        """Return the border of the scan and its path."""
        plan = self.plan
        if plan is None:
            return ()
        path = scan_path(plan, self.half)
        (border,) = cutout_of(*plan.anchor, plan.period, colour="#ffffff")
        return Outline(path, "#b0ffffff", closed=False, width=0.8), border

    def cutout_overlays(self) -> tuple[Overlay, ...]:
        """Return the cutout in the middle of the scan, and dashed what all cutouts together have."""
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
    """Return the places that are on a sensor of so many pixels, or one that is not."""
    inside: NDArray[np.float64] = places[(places >= -0.5) & (places <= side - 0.5)]
    return inside if inside.size else places[:1]


def _drawn(camera: Camera, rows: NDArray[Any], columns: NDArray[Any], step: float) -> NDArray[np.float32]:
    """Return lenslets as discs, or as squares without gaps, at sensor rows and columns."""
    lattice = camera.lattice
    values = np.full((rows.size, columns.size), DARK, np.float32)
    if camera.pitch_px >= FINEST * step:
        xy = camera.sensor_um(np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1))
        index = lattice.lenslet_at(xy)
        within, basis, reach = (index - np.floor(index)).astype(np.float32), lattice.basis_um().astype(np.float32), None
        # the nearest lenslet is at one of the corners of the cell
        for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
            x, y = np.moveaxis((within - np.array(corner, np.float32)) @ basis, -1, 0)
            away = np.maximum(np.abs(x), np.abs(y)) if lattice.edge_to_edge else np.hypot(x, y)
            reach = away if reach is None else np.minimum(reach, away)
        assert reach is not None
        radius = lattice.clear_diameter_um / 2
        # brighter in the middle, so that neighbours that touch are distinguished; edges are one sample wide
        lit = np.clip((radius - reach) / (step * camera.sensor.pixel_um) + 0.5, 0, 1)
        out = np.minimum(reach / max(radius, 1e-6), 1)  # an aperture may be described as a point
        values = (DARK + (LIT - DARK - SHADE * out**4) * lit).astype(np.float32)
    return values


@lru_cache(maxsize=4)
@lru_cache(maxsize=4)
def apertures_of(camera: Camera, depths_um: tuple[float, ...], cutout: tuple[int, int]) -> tuple[Aperture | None, ...]:
    """Return the apertures that are expected in planes; None: in focus, or not to be seen."""
    from lfcal.psf.aperture import expected_aperture

    return tuple(expected_aperture(camera, depth, cutout) for depth in depths_um)
