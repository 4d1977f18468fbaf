"""The fields of the camera's forms. No Qt."""

from __future__ import annotations

import math

from lfcal_gui.models import Field

__all__ = ["BASIC", "LATTICE", "LIGHT", "MAIN_LENS", "MICROSCOPE", "SENSOR"]

DEGREE = math.pi / 180

MAIN_LENS = (
    Field(
        "optics.kind",
        "Optics",
        kind="choice",
        choices=(("MainLens", "main lens"), ("Microscope", "microscope")),
        tip="A photographic main lens, or a telecentric microscope",
    ),
    Field("optics.focal_length_um", "Focal length", "mm", "Focal length of the main lens", scale=1e3),
    Field("optics.f_number", "f-number", "", "As set on the lens: focal length over entrance pupil"),
    Field(
        "optics.working_distance_um",
        "Distance",
        "mm",
        "From the lens to the plane whose image lies on the lenslets",
        scale=1e3,
    ),
    Field("optics.blades", "Iris blades", "", "0 is a circular iris", kind="int"),
    Field(
        "optics.blade_rotation_rad",
        "Iris rotation",
        "°",
        "Angle of the first vertex from the column axis",
        scale=DEGREE,
    ),
    Field("optics.blade_curvature", "Blade curvature", "", "0 straight edges … 1 a circle"),
)

MICROSCOPE = (
    MAIN_LENS[0],
    Field("optics.magnification", "Magnification", "×", "Objective and tube lens together"),
    Field("optics.numerical_aperture", "Numerical aperture", "", "Object-side NA of the objective"),
    Field("optics.medium_index", "Medium index", "", "Refractive index of the immersion medium"),
    Field("optics.tube_length_um", "Tube lens", "mm", "Focal length of the tube lens", scale=1e3),
)

LATTICE = (
    Field(
        "lattice.kind",
        "Array",
        kind="choice",
        choices=(("hexagonal", "hexagonal"), ("square", "square")),
        tip="Arrangement of the lenslets",
    ),
    Field("lattice.pitch_um", "Pitch", "µm", "Distance of neighbouring micro-images along a row, on the sensor"),
    Field(
        "lattice.row_pitch_um",
        "Row distance",
        "µm",
        "Distance of rows if not the ideal one; empty: ideal",
        optional=True,
        empty="ideal",
    ),
    Field("lattice.gap_um", "Gap", "µm", "Distance B from lenslets to sensor"),
    Field(
        "lattice.rotation_rad", "Rotation", "°", "From the column axis towards the row axis (clockwise)", scale=DEGREE
    ),
    Field(
        "lattice.shear_rad",
        "Shear",
        "°",
        "By how much the angle from a row to the next departs from the ideal one",
        scale=DEGREE,
    ),
    Field("lattice.offset_x", "Offset x", "µm", "Centre of a type-0 micro-image, right of the sensor's centre"),
    Field("lattice.offset_y", "Offset y", "µm", "Centre of a type-0 micro-image, below the sensor's centre"),
    Field(
        "lattice.clear_um",
        "Clear diameter",
        "µm",
        "Of a lenslet as seen on the sensor, round within its cell; empty: squares without gaps, discs of the pitch",
        optional=True,
        empty="as wide as the pitch",
    ),
    Field(
        "lattice.focus",
        "Types in focus at v",
        "",
        "Virtual depths in focus, one or three; inf: focused at infinity (f = gap)",
        kind="floats",
        endless=True,
    ),
    Field(
        "lattice.distortion",
        "Distortion",
        "",
        "Departure of the micro-images from straight rows, and its largest size; measured in a white image",
        kind="shown",
    ),
)

SENSOR = (
    Field("sensor.rows", "Rows", "px", "Pixels from top to bottom", kind="int"),
    Field("sensor.columns", "Columns", "px", "Pixels from left to right", kind="int"),
    Field("sensor.pixel_um", "Pixel pitch", "µm", "Seen at the lenslets, if relay optics lie between"),
    Field("sensor.bit_depth", "Bit depth", "bit", "Bits per sample", kind="int"),
    Field("sensor.full_well_e", "Full well", "e⁻", "Electrons at the highest sample value"),
    Field(
        "sensor.saturation",
        "Saturation",
        "counts",
        "Sample value from which samples say nothing; empty: the highest one only",
        optional=True,
        empty="the highest",
    ),
    Field("sensor.read_noise_e", "Read noise", "e⁻ rms", "Noise without light"),
    Field("sensor.dark_current_e_s", "Dark current", "e⁻/s", "Of each pixel; its noise is what a long exposure adds"),
    Field("sensor.black_level", "Black level", "counts", "Sample value without light"),
    Field("sensor.prnu", "PRNU", "", "Pixel response non-uniformity, rms, relative"),
    Field(
        "sensor.dsnu_e",
        "DSNU",
        "e⁻ rms",
        "Offsets of the pixels in the dark; empty: not known",
        optional=True,
        empty="not known",
    ),
    Field(
        "sensor.linearity",
        "Non-linearity",
        "",
        "Largest relative departure of the signal from a line; empty: not known",
        optional=True,
        empty="not known",
    ),
    Field("sensor.quantum_efficiency", "Quantum efficiency", "", "Detected share of photons"),
    Field("sensor.fill_factor", "Fill factor", "", "Light-sensitive share of a pixel"),
    Field(
        "sensor.cfa",
        "Colour filter",
        "",
        "Pattern by rows, e.g. GRBG; empty: monochrome",
        kind="text",
        empty="monochrome",
    ),
)

LIGHT = (
    Field("camera.wavelength_um", "Wavelength", "nm", "Of the light the camera is calibrated with", scale=1e-3),
    Field("camera.bandwidth_um", "Bandwidth", "nm", "Full width of the light's spectrum", scale=1e-3),
)

BASIC = (
    *("optics.focal_length_um", "optics.f_number", "optics.working_distance_um"),
    *("optics.magnification", "optics.numerical_aperture", "optics.tube_length_um"),
    *("lattice.pitch_um", "sensor.pixel_um", "camera.wavelength_um"),
)
"""Values that a camera cannot do without: three of a main lens or of a microscope, and three of the rest."""
