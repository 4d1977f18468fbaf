"""Effects on the position of the main lens's image: field curvature and distortion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from lfcal.base import InputError
from lfcal.simulate.effects.base import Effect, Estimate, SceneEffect
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import ImageMap, Scene

__all__ = ["Distortion", "FieldCurvature"]


def refocus_px(outlook: Outlook, by_um: float) -> float:
    """Return the shift of the marginal ray on the sensor (px) if the image moves along the axis by ``by_um`` (µm).

    For a microscope, it is at most 1.5 times the radius of the pupil's shadow.
    """
    shift = abs(by_um) / (2 * outlook.f_number * outlook.depth) / outlook.pixel_um
    return shift if outlook.has_lens else min(shift, 1.5 * outlook.shadow_px)


@dataclass(frozen=True, slots=True)
class FieldCurvature(SceneEffect):
    """Curvature of the image surface: the distance between main lens and image depends on the field position.

    Attributes
    ----------
    radius_um
        Radius of curvature R of the image surface at the axis (µm), the Petzval radius if the lens has no astigmatism.
        At the distance h from the axis, the image is h²/(2 R) farther from the main lens, or nearer if R is negative.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import FieldCurvature, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), (127, 127), (55, 95), field_um=(6e3, 8e3))
    >>> FieldCurvature(radius_um=-200e3).sag_um(plane)  # µm, at 10 mm from the axis
    -250.0
    """

    radius_um: float = -200e3

    name: ClassVar[str] = "field_curvature"
    title: ClassVar[str] = "field curvature"
    rank: ClassVar[int] = 66
    deviation: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the radius."""
        Effect.__post_init__(self)
        if self.radius_um == 0:
            raise InputError.expected(
                f"{self.title}: radius_um", "a radius that is not 0", 0, "leave the effect out for a flat field"
            )

    def sag_um(self, outlook: Outlook) -> float:
        """Return the additional distance of the image from the main lens in the middle of the region (µm).

        It is negative for a negative `radius_um`.
        """
        y, x = outlook.field_um
        return (y * y + x * x) / (2 * self.radius_um)

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the size of the image's axial shift (µm), and the relative error due to the mean spot shift."""
        sag = self.sag_um(outlook)
        error = outlook.moved(2 / 3 * refocus_px(outlook, sag))
        return Estimate(abs(sag), "µm", error, "da = h²/(2 R); shift (2/3) da/(2 Nw v)")

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the image shifted along the axis by `sag_um`.

        Raises
        ------
        InputError
            If the shifted image is not behind the main lens.
        """
        sag = self.sag_um(outlook)
        behind = 1.0 + (scene.image_um + sag) / scene.pupil_um
        if not (math.isfinite(sag) and behind > 0):
            wanted = "a radius that leaves the image behind the main lens"
            raise InputError.expected(f"{self.title} (µm)", wanted, f"{self.radius_um:g}", "give a larger radius")
        return scene.refocused(sag) if sag else scene


@dataclass(frozen=True, slots=True)
class Distortion(SceneEffect):
    """Distortion of the main lens: the magnification depends on the distance from the axis.

    Attributes
    ----------
    relative
        Displacement of an image point divided by its distance from the axis, at ``radius_um``; this ratio grows with
        the square of the distance. Positive values mean pincushion distortion, and negative values barrel distortion.
    radius_um
        Distance from the axis on the sensor to which ``relative`` refers (µm).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Distortion, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), (127, 127), (55, 95), field_um=(6e3, 8e3))
    >>> Distortion(-0.002, radius_um=10e3).at(plane)  # (y, x): 20 µm of 10 mm towards the axis
    (-12.0, -16.0)
    """

    relative: float = -0.002
    radius_um: float = 10e3

    name: ClassVar[str] = "distortion"
    changes_work: ClassVar[bool] = True
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"relative": (-0.5, 0.5), "radius_um": (1.0, 1e9)}
    title: ClassVar[str] = "distortion"
    rank: ClassVar[int] = 67
    deviation: ClassVar[bool] = True
    units: ClassVar[Mapping[str, str]] = {"relative": "share"}

    def at(self, outlook: Outlook) -> tuple[float, float]:
        """Return the displacement ``(y, x)`` of the image in the middle of the region (µm)."""
        y, x = outlook.field_um
        share = self.relative * (y * y + x * x) / self.radius_um**2
        return share * y, share * x

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the displacement in the middle of the region (px), and the relative error due to it.

        Both the spots and the iris's shadow move.
        """
        shift = math.hypot(*self.at(outlook)) / outlook.pixel_um
        return Estimate(
            shift, "px", outlook.source_moved(shift), "k h³; spots move by 1/v of it, the shadow by all of it"
        )

    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with images displaced by the distortion, linearised about the middle of the period.

        Raises
        ------
        InputError
            If an image is farther from the middle of its cutout than half of the cutout's larger side.
        """
        (dy, dx), (y, x) = self.at(outlook), outlook.field_um
        if not (dy or dx):
            return scene
        # d = k h² h: its gradient is k (h² + 2 h h^T)
        k = self.relative / self.radius_um**2
        grows = (k * (3 * y * y + x * x), 2 * k * y * x), (2 * k * y * x, k * (y * y + 3 * x * x))
        middle = tuple((n - 1) / 2 * px for n, px in zip(scene.period, (scene.row_um, scene.pixel_um), strict=True))
        known = scene.image_map or ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        rows = []
        for moved, (gy, gx), (c, ky, kx) in zip((dy, dx), grows, known, strict=True):
            rows.append((c + moved - gy * middle[0] - gx * middle[1], ky + gy, kx + gx))
        found: ImageMap = (rows[0], rows[1])
        moved_scene = replace(scene, image_map=found)
        limit = max(scene.cutout) / 2 * scene.pixel_um
        if not moved_scene.farthest_um <= limit:
            wanted = f"images within {limit:.4g} µm of the centre of their cutout"
            got = f"{moved_scene.farthest_um:.4g} µm"
            raise InputError.expected(
                f"{self.title} of the region", wanted, got, "reduce the effect, or choose a larger cutout"
            )
        return moved_scene


EFFECTS = (FieldCurvature, Distortion)
