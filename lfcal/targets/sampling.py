"""Check whether a camera's pixels are fine enough to move patterns by fractions of a pixel."""

from __future__ import annotations

from lfcal.camera import Camera, ScanPlan

__all__ = ["coarsest_pixel_um", "may_resample", "resampling_words"]


def coarsest_pixel_um(camera: Camera) -> float:
    """Return the largest pixel pitch that samples the light behind a lenslet without loss (µm).

    The light behind a lenslet contains no spatial frequencies above ``1 / (wavelength N)``, where N is the f-number,
    gap divided by pitch (Goodman, Introduction to Fourier Optics, section 6.3). Two samples per period are sufficient.
    """
    lattice = camera.lattice
    found: float = camera.wavelength_um * lattice.gap_um / lattice.pitch_um / 2.0
    return found


def may_resample(camera: Camera) -> bool:
    """Return whether the pixels of a camera are fine enough to resample patterns to other phases without loss."""
    return camera.sensor.pixel_um <= coarsest_pixel_um(camera)


def resampling_words(scan: ScanPlan) -> str:
    """Return a clause that states why patterns of points between the positions are not resampled to the positions."""
    camera = scan.camera
    if may_resample(camera):
        return "their phases differ, which resampling cannot correct"
    wanted, own = coarsest_pixel_um(camera), camera.sensor.pixel_um
    return f"pixels of {own:g} µm are too coarse for resampling, which needs {wanted:.2g} µm"
