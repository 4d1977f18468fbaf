"""Depths of the planes: a common displacement, and one for each plane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lfcal.camera import Camera, MainLens, PupilLenslets
from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import Setup
from lfcal.simulate.effects import DepthError

__all__ = ["CommonDepth", "PlaneDepths"]

HELD = "defocus of the wavefront is included in the distance of the planes"
IMAGES_PX = 0.3
"""Noticeable displacement of an elemental image (pixels)."""

WORKING_SHARE = 0.005
"""Relative prior uncertainty of a working distance."""


def depth_scale(camera: Camera) -> float:
    """Return the displacement of the source in depth (µm) that moves its image by a fiftieth of the gap.

    In a Fourier light-field microscope, the displacement moves the outermost elemental image by `IMAGES_PX`.
    """
    if isinstance(camera.lattice, PupilLenslets):
        assert not isinstance(camera.optics, MainLens)
        radius = max(float(np.hypot(*np.array(camera.lattice.lens_centres_um).T).max()), camera.lattice.clear_um)
        return IMAGES_PX * camera.sensor.pixel_um / (radius * abs(camera.lattice.spread(camera.optics, 1.0)))
    small = 1e-4 * (camera.optics.working_distance_um if isinstance(camera.optics, MainLens) else 1e4)
    rate = abs(camera.image_shift_um(small) - camera.image_shift_um(0.0)) / small
    return 0.02 * camera.lattice.gap_um / rate


class CommonDepth(Group):
    """Distance of the zero of the stage from the working plane, common to all planes."""

    name = "distance"
    title = "distance of all planes"
    rank = 40

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the displacement that is added to every depth (µm)."""
        del frame
        camera = setup.camera
        scale = depth_scale(camera)
        known = WORKING_SHARE * camera.optics.working_distance_um if isinstance(camera.optics, MainLens) else 5 * scale
        return (Unknown("distance_um", self.name, "µm", 0.0, scale, known, gauge=HELD),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with all planes displaced in depth by the value in ``values``."""
        del frame
        moved = tuple(error + values["distance_um"] for error in setup.depth_errors_um)
        return replace(setup, depth_errors_um=moved)


class PlaneDepths(Group):
    """Displacement of each plane from its planned depth."""

    name = "depths"
    title = "depth of each plane"
    rank = 42
    needs = "at least two planes"

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the depth change (µm) of each plane, with a stage's depth error as prior.

        The result is empty for a single plane.
        """
        if frame.planes < 2:
            return ()
        known, scale = DepthError().rms(setup.camera), depth_scale(setup.camera)
        held = f"{HELD}, and the mean depth of all planes is known to within the error of the stage"
        return tuple(
            Unknown(f"depth_{z}_um", self.name, "µm", 0.0, scale, known, gauge=held) for z in range(frame.planes)
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with each plane displaced in depth by its value in ``values``."""
        del frame
        pairs = zip(setup.depth_errors_um, values.values(), strict=True)
        return replace(setup, depth_errors_um=tuple(error + more for error, more in pairs))


GROUPS = (CommonDepth(), PlaneDepths())
