"""Effects of the position of the lenslet array: telecentricity, gap, rotation, pitch and tilt."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from lfcal.base import InputError
from lfcal.simulate.effects.base import WHITE_IMAGE, Estimate, SceneEffect
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Scene

__all__ = ["ArrayRotation", "ArrayTilt", "LensletGap", "PitchError", "Telecentricity"]


@dataclass(frozen=True, slots=True)
class Telecentricity(SceneEffect):
    """Exit pupil at the finite distance b: the pitch of the micro-images is 1 + B/b times that of the lenslets.

    B is the gap between lenslets and sensor. Without this effect, the exit pupil is at infinity, and micro-images have
    the pitch of the lenslets.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook, Telecentricity
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = Telecentricity().estimate(plane)
    >>> print(f"the period grows by {found.size:.2f} {found.unit}; left out: {found.error:.0%} of the image")
    the period grows by 0.33 px; left out: 20% of the image
    """

    name: ClassVar[str] = "telecentricity"
    title: ClassVar[str] = "loss of telecentricity"
    rank: ClassVar[int] = 50
    changes_work: ClassVar[bool] = True

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the increase of the pattern's period (px), and the relative error due to the rms spot shift."""
        optics = outlook.camera.optics
        if optics.telecentric:
            return Estimate(0.0, "px", 0.0, "telecentric")
        excess = outlook.gap_um / optics.image_distance_um
        # micro-images are farther apart than lenslets by the ratio of their distances from the pupil
        period = max(outlook.camera.period_px) * excess
        return Estimate(
            period, "px", outlook.array_moved(excess * outlook.field_rms_px), "period * B/b; shift B/b * r_rms"
        )

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the exit pupil at its actual distance."""
        return replace(scene, pupil_um=outlook.camera.optics.image_distance_um)


@dataclass(frozen=True, slots=True)
class LensletGap(SceneEffect):
    """An error of the gap between lenslets and sensor; the focal lengths are as described.

    Attributes
    ----------
    error_um
        True gap minus described gap (µm).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import LensletGap, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = LensletGap(error_um=5.5).estimate(plane)
    >>> print(f"{found.size:.2f} {found.unit} at the rim of f/5")
    0.10 px at the rim of f/5
    """

    error_um: float = 5.0

    name: ClassVar[str] = "lenslet_gap"
    titles: ClassVar[Mapping[str, str]] = {"error_um": "true minus described gap"}
    title: ClassVar[str] = "lenslet gap error"
    rank: ClassVar[int] = 80
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = "geometry"

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the shift of the marginal ray (px), and the relative error due to the mean shift (2/3 of it)."""
        rim = abs(self.error_um) / (2 * outlook.f_number) / outlook.pixel_um
        return Estimate(rim, "px", outlook.moved(2 / 3 * rim), "dB/(2 Nw) at the rim, 2/3 of it on average")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the true gap."""
        del outlook
        return replace(scene, lattice=replace(scene.lattice, gap_um=scene.lattice.gap_um + self.error_um))


@dataclass(frozen=True, slots=True)
class ArrayRotation(SceneEffect):
    """A rotation of the lenslet array relative to its description, about a type-0 lenslet of the region.

    Attributes
    ----------
    angle_rad
        Rotation from +x (columns) towards +y (rows) (rad).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import ArrayRotation, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = ArrayRotation(angle_rad=1e-3).estimate(plane)
    >>> print(f"{found.size:.3f} {found.unit} at {plane.field_rms_px:.0f} px from the middle")
    0.055 px at 55 px from the middle
    """

    angle_rad: float = math.radians(0.05)

    name: ClassVar[str] = "array_rotation"
    changes_work: ClassVar[bool] = True
    titles: ClassVar[Mapping[str, str]] = {"angle_rad": "turn from +x to +y"}
    title: ClassVar[str] = "array rotation error"
    rank: ClassVar[int] = 81
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = WHITE_IMAGE

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the rms displacement (px) of the lit lenslets, and the relative error due to this displacement."""
        shift = abs(self.angle_rad) * outlook.field_rms_px
        return Estimate(shift, "px", outlook.array_moved(shift), "alpha * r_rms")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the array rotated."""
        del outlook
        turned = replace(scene.lattice, rotation_rad=scene.lattice.rotation_rad + self.angle_rad)
        return replace(scene, lattice=turned)


@dataclass(frozen=True, slots=True)
class PitchError(SceneEffect):
    """An error of the lenslet pitch relative to the camera's description.

    Attributes
    ----------
    relative
        True pitch divided by described pitch, minus 1.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook, PitchError
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = PitchError(1e-3).estimate(plane)
    >>> print(f"{found.size:.3f} {found.unit} at {plane.field_rms_px:.0f} px from the middle")
    0.055 px at 55 px from the middle
    """

    relative: float = 1e-4

    name: ClassVar[str] = "pitch_error"
    changes_work: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]] = {"relative": "share"}
    titles: ClassVar[Mapping[str, str]] = {"relative": "pitch too large by"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"relative": (-0.5, 0.5)}
    title: ClassVar[str] = "lenslet pitch error"
    rank: ClassVar[int] = 82
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = WHITE_IMAGE

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the rms displacement (px) of the lit lenslets, and the relative error due to this displacement."""
        shift = abs(self.relative) * outlook.field_rms_px
        return Estimate(shift, "px", outlook.array_moved(shift), "dp/p * r_rms")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the true pitch."""
        del outlook
        lattice, grow = scene.lattice, 1.0 + self.relative
        # None: the row spacing of the kind of lattice, which grows with the pitch
        rows = None if lattice.row_pitch_um is None else lattice.row_pitch_um * grow
        return replace(scene, lattice=replace(lattice, pitch_um=lattice.pitch_um * grow, row_pitch_um=rows))


@dataclass(frozen=True, slots=True)
class ArrayTilt(SceneEffect):
    """A lenslet array that is not parallel to the sensor: it is tilted about its intersection with the optical axis.

    Where the tilt increases the gap, the lenslets are closer to the main lens, whose image is then farther behind them
    by the same distance. The gap also varies from lenslet to lenslet, which displaces the rays through their centres.
    The lattice of micro-images remains as described.

    Attributes
    ----------
    rows_rad, columns_rad
        Slope of the gap between lenslets and sensor from row to row (along y) and from column to column (along x)
        (rad).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import ArrayTilt, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), (127, 127), (55, 95), field_um=(0.0, 5e3))
    >>> ArrayTilt(columns_rad=1e-3).farther_um(plane)  # µm, at 5 mm from the axis
    5.0
    """

    rows_rad: float = 0.0
    columns_rad: float = 1e-3

    name: ClassVar[str] = "array_tilt"
    changes_work: ClassVar[bool] = True
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"rows_rad": (-0.2, 0.2), "columns_rad": (-0.2, 0.2)}
    title: ClassVar[str] = "array tilt"
    rank: ClassVar[int] = 83
    deviation: ClassVar[bool] = True
    measured_by: ClassVar[str] = "array_tilt"

    def farther_um(self, outlook: Outlook) -> float:
        """Return the increase of the gap in the middle of the region due to the tilt (µm)."""
        return self.rows_rad * outlook.field_um[0] + self.columns_rad * outlook.field_um[1]

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the absolute change of the gap (µm), and the relative error due to the resulting spot shift."""
        farther, tilt = self.farther_um(outlook), math.hypot(self.rows_rad, self.columns_rad)
        across = outlook.shadow_px * outlook.pixel_um * tilt
        v = outlook.virtual_depth
        # the widths of spots change as well; near the native plane, that of the whole cone does
        rate = math.hypot(1.0 - 1.0 / v, 0.45) if abs(v) >= 1.0 else 1.0
        cone = rate / (2 * outlook.f_number) / outlook.pixel_um
        shift = math.hypot(2 / 3 * farther, across / math.pi) * cone
        formula = "hypot(2/3 d, t r/pi) (1 - 1/v)/(2 Nw), d = t h"
        return Estimate(abs(farther), "µm", outlook.moved(shift), formula)

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the gap and image distance of the region, and with the tilt about its middle.

        Raise `InputError` if the gap in the region would be less than a fifth or more than three times that on the
        axis. Do the same if the lenslets would be at the exit pupil or beyond it.
        """
        farther = self.farther_um(outlook)
        gap = scene.gap_um + farther
        if not scene.pupil_um > farther:
            wanted, got = f"a shift of the region of less than {scene.pupil_um:.4g} µm", f"{farther:.4g} µm"
            raise InputError.expected(f"{self.title} (rad)", wanted, got, "give a smaller tilt")
        if not 0.2 * scene.gap_um <= gap <= 3 * scene.gap_um:
            wanted = f"a gap from a fifth to three times the {scene.gap_um:.4g} µm on the axis"
            raise InputError.expected(
                f"{self.title} (rad)", wanted, f"{gap:.4g} µm in the region", "give a smaller tilt"
            )
        tilt = scene.tilt[0] + self.rows_rad, scene.tilt[1] + self.columns_rad
        lattice = replace(scene.lattice, gap_um=gap)
        # the main lens does not move: its pupil is closer by the same distance as the image is farther
        found = replace(scene, lattice=lattice, pupil_um=scene.pupil_um - farther, tilt=tilt)
        return found.refocused(farther)


EFFECTS = (Telecentricity, LensletGap, ArrayRotation, PitchError, ArrayTilt)
