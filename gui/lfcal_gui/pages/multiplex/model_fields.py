"""The fields of the Multiplexing page: what is asked for, and what each value means. No Qt."""

from __future__ import annotations

from lfcal.frames.formats import image_suffixes
from lfcal.multiplex import CFA_PATTERNS, FILTERS, GRAMMAR, MASKS, SPATIAL_FILTERS
from lfcal_gui.models import Field

TYPED = "typed"
"""In place of the name of a pattern: the user's own letters."""

MAX_SIZE = 31

IMAGES = f"Images ({' '.join('*' + suffix for suffix in sorted(image_suffixes()))});;All files (*)"
"""Kinds of files that hold images."""


def _named(names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    return tuple((name, name.replace("_", " ")) for name in names)


FAMILIES = (
    ("cfa", "colour filters"),
    ("mask", "mask or lenslets"),
    ("both", "mask over filters"),
    ("written", "as written"),
)
FIELDS = (
    Field("family", "Family", kind="choice", choices=FAMILIES, tip="What lies in front of the sensor"),
    Field(
        "cfa",
        "Filters",
        kind="choice",
        choices=(*_named(tuple(CFA_PATTERNS)), (TYPED, "own pattern")),
        tip="Colour filter array; own pattern: the letters below",
    ),
    Field(
        "pattern",
        "Own pattern",
        kind="text",
        tip=f"Letters of {''.join(FILTERS)} by rows, such as GRBG or "
        "RGB/GBR: R G B, C = G + B, M = R + B, Y = R + G, W = all, E = emerald (as C)",
    ),
    Field("mask", "Mask", kind="choice", choices=_named(MASKS), tip="Light-field modulator"),
    Field(
        "size",
        "Size",
        "px",
        f"Pixels and views along a side, up to {MAX_SIZE}; MURA: odd primes, sum of sinusoids: odd",
        kind="int",
    ),
    Field("written", "Written", kind="text", tip=f"Any modulator: {GRAMMAR}"),
    Field(
        "reference_written",
        "Over",
        kind="text",
        tip="Reference, written in the same way; gains are relative to it",
        group="Reference",
    ),
    Field(
        "reference_cfa",
        "Over filters",
        kind="choice",
        choices=_named(tuple(CFA_PATTERNS)),
        tip="Filters of the reference; gains are relative to it",
        group="Reference",
    ),
    Field(
        "reference_mask",
        "Over mask",
        kind="choice",
        choices=_named(MASKS),
        tip="Mask of the reference, of the same size; gains are relative to it",
        group="Reference",
    ),
    Field("gain", "Amplifier", "×", "Amplifier gain: full scale is reached at full well over gain", group="Noise"),
    Field(
        "scene",
        "Scene",
        kind="choice",
        choices=(("edges", "sharp edges"), ("smooth", "smooth"), ("image", "opened image"), ("live", "live frames")),
        tip="What is recorded. An opened grey image is used as the recorded frame, a colour image as the scene. "
        "Live frames are those that Record > Rig shows",
    ),
    Field(
        "filter",
        "Filter",
        kind="choice",
        choices=_named(SPATIAL_FILTERS),
        tip="Interpolation of the spatial route (theorem 1); the Fourier route is a sinc (theorem 2)",
        group="Reconstruction",
    ),
    Field(
        "weighted",
        "Leave out clipped",
        kind="bool",
        tip="Spatial route of opened and live frames: ignore saturated pixels, and weight others by the camera's noise",
        group="Reconstruction",
    ),
    Field(
        "route",
        "Route",
        kind="choice",
        choices=(("cells", "super-pixels"), ("general", "general"), ("lattice", "real lattice")),
        tip="Super-pixels: the mask repeats in whole pixels. General: any transmissions, by iterative regularised "
        "least squares; slower. Real lattice: any pitch and angle, from the white image below or the project's camera",
        group="Reconstruction",
    ),
    Field(
        "dead",
        "Dead pixels",
        kind="text",
        empty="none",
        tip="Image of the size of the frame, nonzero at dead pixels. They are ignored in the spatial and general route "
        "of opened and live frames",
        group="Reconstruction",
        file=IMAGES,
    ),
    Field(
        "white",
        "White image",
        kind="text",
        empty="auto",
        tip="Image, or folder of images, of uniform light, in which the lattice is measured. Empty: the white image of "
        "Record > Folder if its size matches this frame, else the lattice of the project's camera",
        group="Reconstruction",
        file=IMAGES,
    ),
    Field(
        "transmissions",
        "Transmissions",
        kind="text",
        empty="auto",
        tip=".npy (N, rows, columns): transmission of each sample at each pixel of the frame, for masks that do not "
        "repeat; empty: those of the modulator",
        group="Reconstruction",
        file="Arrays (*.npy)",
    ),
    Field(
        "spacing",
        "Node spacing",
        "px",
        "Distance of the grid nodes of the general route, 0.5 or more; empty: from the number of measuring pixels",
        optional=True,
        empty="auto",
        group="Reconstruction",
    ),
    Field(
        "smoothness",
        "Smoothness",
        "",
        "Weight of differences between grid nodes. It fixes what the pixels do not determine; keep it well below the "
        "signal-to-noise ratio",
        group="Reconstruction",
    ),
    Field(
        "noise",
        "Camera noise",
        kind="bool",
        tip="Add shot and read noise of the project's camera to a built-in "
        "scene; its brightest pixel fills the full well",
        group="Noise",
    ),
)

BASIC = ("family", "cfa", "pattern", "mask", "size", "written", "scene")
"""Keys of `FIELDS` that are in view where they matter; the others are folded."""

SEARCH_FIELDS = (
    Field(
        "sought",
        "Search for",
        kind="choice",
        choices=(("filters", "filters, 2 × 2"), ("filters 2x3", "filters, 2 × 3"), ("mask", "printed mask")),
        tip="All layouts of filters are tried. All masks are tried if there are few, else the best found is given",
    ),
    Field("search_size", "Mask side", "px", "Pixels along a side of the mask, 2 to 13", kind="int"),
    Field("levels", "Levels", "", "Transmissions that can be printed: 2 for open and closed", kind="int"),
    Field("kinds", "Kinds", "", "Largest number of different filters", kind="int"),
    Field("crosstalk", "Crosstalk", "", "Share of the light that pixels lose to their four neighbours, 0 to 0.4"),
    Field("least_light", "Least light", "", "Share of the light that must pass, 0 to below 1"),
)
