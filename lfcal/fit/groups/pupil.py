"""Lenslets of a Fourier light-field microscope, its optical axis, and the travel of the source along it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lfcal.camera import Camera, PupilLenslets
from lfcal.fit.parameters import Group, ScanScales, Unknown
from lfcal.fit.setup import Setup

__all__ = ["AxisPlace", "PupilLength", "PupilLensletPlaces", "TravelTilt"]

NEEDS = "a Fourier light-field microscope"

STEP_PX = 0.1
"""Noticeable displacement of an elemental image (pixels)."""

MOST_TILT = 0.3
"""Largest tilt of the travel (rad)."""


def lenslets_of(setup: Setup) -> PupilLenslets | None:
    """Return the lenslets in the pupil plane; None for a camera with a periodic array."""
    lattice = setup.camera.lattice
    return lattice if isinstance(lattice, PupilLenslets) else None


def _changed(setup: Setup, **values: object) -> Setup:
    def changed(camera: Camera) -> Camera:
        return replace(camera, lattice=replace(camera.lattice, **values))  # type: ignore[arg-type]

    return setup.edited(changed)


class PupilLensletPlaces(Group):
    """Position of each lenslet on the sensor, from which its centre relative to the optical axis follows."""

    name = "lens_centres"
    title = "centre of each lenslet"
    rank = 10
    core = True
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the position (x, y) of each lenslet relative to the centre of the sensor (µm)."""
        del frame
        lenslets, px = lenslets_of(setup), setup.camera.sensor.pixel_um
        if lenslets is None:
            return ()
        places = np.array(lenslets.lens_centres_um) + np.array(lenslets.offset_um)
        apart = min(lenslets.spacing_um, 100 * lenslets.clear_um)
        return tuple(
            Unknown(f"lenslet_{k}_{axis}_um", self.name, "µm", v, STEP_PX * px, None, v - apart, v + apart)
            for k, place in enumerate(places.tolist())
            for axis, v in zip("xy", place, strict=True)
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the lenslets at the positions in ``values``."""
        del frame
        lenslets = lenslets_of(setup)
        assert lenslets is not None
        places = np.array(list(values.values())).reshape(-1, 2) - np.array(lenslets.offset_um)
        return _changed(setup, lens_centres_um=tuple(map(tuple, places.tolist())))


class AxisPlace(Group):
    """Intersection of the optical axis with the sensor; the lenslets keep their positions on the sensor.

    Because patterns are the same everywhere in the field, only a source on the axis shows where the axis is.
    """

    name = "optical_axis"
    title = "position of the optical axis on the sensor"
    rank = 11
    core = True
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the position (x, y) of the optical axis relative to the centre of the sensor (µm)."""
        del frame
        lenslets, px = lenslets_of(setup), setup.camera.sensor.pixel_um
        if lenslets is None:
            return ()
        far, held = lenslets.clear_um, "the source is on the optical axis at depth 0"
        return tuple(
            Unknown(f"axis_{axis}_um", self.name, "µm", v, 10 * STEP_PX * px, None, v - far, v + far, gauge=held)
            for axis, v in zip("xy", lenslets.offset_um, strict=True)
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the optical axis at the position in ``values``, and the sources displaced with it."""
        del frame
        lenslets = lenslets_of(setup)
        assert lenslets is not None
        offset = np.array([values["axis_x_um"], values["axis_y_um"]])
        moved = offset - np.array(lenslets.offset_um)
        centres = np.array(lenslets.lens_centres_um) - moved
        x, y = (moved / setup.camera.sensor.pixel_um).tolist()
        rows, columns = setup.aside_px
        found = replace(setup, aside_px=(rows + y, columns + x))
        return _changed(found, lens_centres_um=tuple(map(tuple, centres.tolist())), offset_um=tuple(offset.tolist()))


class PupilLength(Group):
    """A length of a Fourier light-field microscope, such as the gap between lenslets and sensor.

    Parameters
    ----------
    name, title, rank
        As in `lfcal.fit.Group`.
    field
        Name of the length in `lfcal.camera.PupilLenslets`, and of the unknown.
    share
        Noticeable change of the length, as a fraction of it.
    gauge
        Quantities that are fixed because patterns do not distinguish them from the length.
    """

    core = True
    needs = NEEDS

    def __init__(self, name: str, title: str, rank: int, field: str, share: float, gauge: str) -> None:
        self.name, self.title, self.rank, self.field, self.share, self.gauge = name, title, rank, field, share, gauge

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknown: the length (µm); empty for a camera with a periodic array."""
        del frame
        lenslets = lenslets_of(setup)
        if lenslets is None:
            return ()
        now: float = getattr(lenslets, self.field)
        scale = self.share * now
        return (Unknown(self.field, self.name, "µm", now, scale, None, 0.5 * now, 2 * now, gauge=self.gauge),)

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the length in ``values``."""
        del frame
        return _changed(setup, **{self.field: values[self.field]})


class TravelTilt(Group):
    """Tilt, relative to the optical axis, of the direction in which the stage moves the source in depth."""

    name = "travel_tilt"
    title = "tilt of the source's travel relative to the optical axis"
    rank = 14
    core = True
    needs = NEEDS

    def unknowns(self, setup: Setup, frame: ScanScales) -> tuple[Unknown, ...]:
        """Return the unknowns: the tilt along y (towards higher rows) and along x (towards higher columns) (rad).

        The result is empty for a camera with a periodic array.
        """
        del frame
        if lenslets_of(setup) is None:
            return ()
        return tuple(
            Unknown(f"travel_{axis}_rad", self.name, "rad", v, 2e-3, None, -MOST_TILT, MOST_TILT)
            for axis, v in zip(("rows", "columns"), setup.travel_rad, strict=True)
        )

    def applied(self, setup: Setup, values: Mapping[str, float], frame: ScanScales) -> Setup:
        """Return the setup with the tilt in ``values``."""
        del frame
        return replace(setup, travel_rad=(values["travel_rows_rad"], values["travel_columns_rad"]))


GROUPS = (
    PupilLensletPlaces(),
    AxisPlace(),
    PupilLength(
        "fourier_lens",
        "focal length of the Fourier lens",
        12,
        "fourier_um",
        1e-3,
        "magnification (focal lengths of objective and tube lens), index and depths are fixed: patterns show the ratio "
        "of the magnification to the focal length of the Fourier lens",
    ),
    PupilLength(
        "lenslet_gap",
        "gap between the lenslets and the sensor",
        13,
        "gap_um",
        2e-3,
        "wavelength and clear diameter of the lenslets are fixed",
    ),
    TravelTilt(),
)
