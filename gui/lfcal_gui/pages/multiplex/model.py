"""Settings of the Multiplexing page, field by field, and images of its modulators. No Qt."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, any_of, check_number
from lfcal.frames.formats import image_suffixes
from lfcal.multiplex import (
    CFA_PATTERNS,
    GRAMMAR,
    MASKS,
    SPATIAL_FILTERS,
    Modulator,
    cfa,
    mask,
    mask_pattern,
    modulator_of,
    parse_pattern,
)
from lfcal_gui.models import Field, PageSettings

TYPED = "typed"
"""Choice of a pattern that the user types as letters."""

MAX_SIZE = 31

IMAGES = f"Images ({' '.join('*' + suffix for suffix in sorted(image_suffixes()))});;All files (*)"
"""File filter for images."""


def _named(names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    return tuple((name, name.replace("_", " ")) for name in names)


FAMILIES = (
    ("cfa", "colour filters"),
    ("mask", "mask or lenslets"),
    ("both", "mask over filters"),
    ("written", "expression"),
)
FIELDS = (
    Field("family", "Family", kind="choice", choices=FAMILIES, tip="Kind of modulator in front of the sensor"),
    Field(
        "cfa",
        "Filters",
        kind="choice",
        choices=(*_named(tuple(CFA_PATTERNS)), (TYPED, "custom pattern")),
        tip="Colour filter array. Custom pattern: the array given by the letters below",
    ),
    Field(
        "pattern",
        "Custom pattern",
        kind="text",
        tip="Letters of the filters, row by row, with rows separated by a slash (RGB/GBR); a square pattern "
        "needs no slash (GRBG). R, G, B; C = G + B, M = R + B, Y = R + G, W = all, E = emerald (as C)",
    ),
    Field("mask", "Mask", kind="choice", choices=_named(MASKS), tip="Mask or lenslets that modulate the light field"),
    Field(
        "size",
        "Size",
        "px",
        f"Pixels and views along a side, up to {MAX_SIZE}; MURA: odd primes, sum of sinusoids: odd",
        kind="int",
    ),
    Field("written", "Expression", kind="text", tip=f"Modulator as an expression, such as {GRAMMAR}"),
    Field(
        "reference_written",
        "Reference",
        kind="text",
        tip="Reference as an expression. Gains are relative to it",
        group="Reference",
    ),
    Field(
        "reference_cfa",
        "Reference filters",
        kind="choice",
        choices=_named(tuple(CFA_PATTERNS)),
        tip="Filters of the reference. Gains are relative to it",
        group="Reference",
    ),
    Field(
        "reference_mask",
        "Reference mask",
        kind="choice",
        choices=_named(MASKS),
        tip="Mask of the reference; it has the size of the mask above. Gains are relative to the reference",
        group="Reference",
    ),
    Field(
        "gain",
        "Amplifier",
        "×",
        "Amplifier gain. Full scale is reached at the full well divided by the gain",
        group="Noise",
    ),
    Field(
        "scene",
        "Scene",
        kind="choice",
        choices=(("edges", "sharp edges"), ("smooth", "smooth"), ("image", "opened image"), ("live", "live frames")),
        tip="Scene that is recorded. An opened grey image is used as the recorded frame, a colour "
        "image as the scene. Live frames are those that Record > Rig shows",
    ),
    Field(
        "filter",
        "Filter",
        kind="choice",
        choices=_named(SPATIAL_FILTERS),
        tip="Interpolation of the spatial route (theorem 1); the Fourier route always uses a sinc (theorem 2)",
        group="Reconstruction",
    ),
    Field(
        "weighted",
        "Ignore saturated",
        kind="bool",
        tip="Spatial route of opened and live frames: ignore saturated pixels, and weight the others "
        "by the noise of the camera",
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
        tip="Image of the same size as the frame, nonzero at dead pixels. For opened and live frames, every route "
        "except Fourier ignores these pixels",
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
        "repeat. Empty: those of the modulator",
        group="Reconstruction",
        file="Arrays (*.npy)",
    ),
    Field(
        "spacing",
        "Node spacing",
        "px",
        "Distance between grid nodes of the general route, 0.5 or more. Empty: the square root of the "
        "number of samples",
        optional=True,
        empty="auto",
        group="Reconstruction",
    ),
    Field(
        "smoothness",
        "Smoothness",
        "",
        "Weight of differences between adjacent grid nodes, relative to the weight of the pixels. It determines "
        "samples that no pixel measures; larger values give a smoother result",
        group="Reconstruction",
    ),
    Field(
        "noise",
        "Camera noise",
        kind="bool",
        tip="Add shot and read noise of the project's camera to a built-in scene, whose brightest "
        "pixel reaches the full well",
        group="Noise",
    ),
)

BASIC = ("family", "cfa", "pattern", "mask", "size", "written", "scene")
"""Keys of `FIELDS` that are shown if they apply; the others are folded."""

SEARCH_FIELDS = (
    Field(
        "sought",
        "Search for",
        kind="choice",
        choices=(("filters", "filters, 2 × 2"), ("filters 2x3", "filters, 2 × 3"), ("mask", "printed mask")),
        tip="All filter layouts are tried. If there are too many masks to try them all, the result "
        "is the best mask found",
    ),
    Field("search_size", "Mask side", "px", "Pixels along a side of the mask, 2 to 13", kind="int"),
    Field("levels", "Levels", "", "Number of transmission levels that can be printed; 2: open and closed", kind="int"),
    Field("kinds", "Filter kinds", "", "Largest number of different filters", kind="int"),
    Field("crosstalk", "Crosstalk", "", "Fraction of the light that a pixel loses to its four neighbours, 0 to 0.4"),
    Field(
        "least_light",
        "Minimum light",
        "",
        "Smallest fraction of the light that filters or mask must transmit, 0 to below 1",
    ),
)


RANGES = {"search_size": (2, 13), "levels": (2, 16), "kinds": (1, 6), "crosstalk": (0, 0.4), "least_light": (0, 0.99)}
MAX_ENTRIES = 350_000
"""Largest number of entries of the matrix A of a mask over colour filters, or of an expression."""
Array = NDArray[np.float64]


_USES: dict[str, Callable[[MultiplexSettings], bool]] = {
    "cfa": lambda s: s.family in ("cfa", "both"),
    "pattern": lambda s: s.family in ("cfa", "both") and s.cfa == TYPED,
    "mask": lambda s: s.family in ("mask", "both"),
    "size": lambda s: s.family in ("mask", "both"),
    "reference_cfa": lambda s: s.family in ("cfa", "both"),
    "reference_mask": lambda s: s.family in ("mask", "both"),
    "written": lambda s: s.family == "written",
    "reference_written": lambda s: s.family == "written",
    "search_size": lambda s: s.sought == "mask",
    "levels": lambda s: s.sought == "mask",
    "kinds": lambda s: s.sought != "mask",
    "dead": lambda s: s.scene in ("image", "live"),
    "white": lambda s: s.scene in ("image", "live") and s.route == "lattice",
    "transmissions": lambda s: s.route == "general",
    "spacing": lambda s: s.route == "general",
    "smoothness": lambda s: s.route == "general",
    "noise": lambda s: s.scene in ("edges", "smooth"),
}


LINEAR = (
    "Saturated or dead pixels are left out, so the spatial route interpolates linearly. To "
    "choose a filter, use all pixels: untick Ignore saturated, and clear Dead pixels"
)
"""Reason why no filter can be chosen."""


def used_by(settings: MultiplexSettings, key: str, *, colour: bool = False) -> bool:
    """Return whether the field ``key`` applies; ``colour``: whether the opened image is a colour scene, not a frame."""
    if key == "weighted":
        return settings.scene == "live" or (settings.scene == "image" and not colour)
    if key == "filter":
        return settings.route != "general" and not weighs(settings, colour=colour)
    return key not in _USES or _USES[key](settings)


def weighs(settings: MultiplexSettings, *, colour: bool = False) -> bool:
    """Return whether the pixels of the frame are weighted; ``colour`` as in `used_by`."""
    clipped = settings.weighted and used_by(settings, "weighted", colour=colour)
    return clipped or (bool(settings.dead) and used_by(settings, "dead"))


def why_unused(settings: MultiplexSettings, key: str, *, colour: bool = False) -> str:
    """Return why a field does not apply, if its tooltip does not explain it; else empty."""
    linear = key == "filter" and settings.route != "general" and weighs(settings, colour=colour)
    return LINEAR if linear else ""


@dataclass(frozen=True)
class MultiplexSettings(PageSettings):
    """Settings of the page; see `FIELDS`.

    Attributes
    ----------
    compared
        Names of filter arrays and masks whose gain is compared with that of the chosen modulator.
    image
        Path of the opened image; empty if none.
    right
        Third image: ``"difference"`` of the routes or ``"truth"``.
    figure, own_camera
        Number of the figure of the paper (0: map of gains), and whether to use the project's camera instead of
        the paper's.
    route, dead, white, transmissions, spacing, smoothness
        Method of reconstruction (`lfcal_gui.pages.multiplex.model_scene`); files are paths or empty.
    sought, search_size, levels, kinds, crosstalk, least_light
        Settings of the search (`lfcal_gui.pages.multiplex.model_compare`).
    """

    page: ClassVar[str] = "multiplex"

    family: str = "cfa"
    cfa: str = "CYMG"
    pattern: str = "GRBG"
    mask: str = "MURA"
    size: int = 11
    reference_cfa: str = "Bayer"
    reference_mask: str = "pinhole"
    written: str = "polarisers:0,45/135,90"
    reference_written: str = "polarisers:0,45,90"
    gain: float = 1.0
    scene: str = "edges"
    filter: str = "cubic"
    noise: bool = False
    weighted: bool = False
    compared: tuple[str, ...] = ("CYMG", "Sony", "RGBW", "CMYW", "lenslet", "MURA", "sum_of_sinusoids")
    image: str = ""
    right: str = "difference"
    figure: int = 7
    own_camera: bool = False
    route: str = "cells"
    dead: str = ""
    white: str = ""
    transmissions: str = ""
    spacing: float | None = None
    smoothness: float = 1e-4
    sought: str = "filters"
    search_size: int = 5
    levels: int = 2
    kinds: int = 4
    crosstalk: float = 0.0
    least_light: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        asked = (*FIELDS, *SEARCH_FIELDS)
        labels = {f.key: f.label for f in asked}
        offered = {f.key: tuple(value for value, _ in f.choices) for f in asked if f.kind == "choice"}
        offered["right"] = ("difference", "truth")
        for key, values in offered.items():
            if getattr(self, key) not in values:
                raise InputError.expected(
                    labels.get(key, key), any_of(values), getattr(self, key), "choose one of these"
                )
        parse_pattern(self.pattern)
        if not 1 <= self.size <= MAX_SIZE:
            raise InputError.expected("size (px)", f"1 to {MAX_SIZE}", self.size, "enter a size such as 9")
        mask_pattern(self.mask, self.size)
        if not 0 < self.gain < 1e6:
            raise InputError.expected("amplifier gain", "a gain above 0", self.gain, "enter 1 for no amplification")
        if self.spacing is not None:
            check_number("node spacing (px)", self.spacing, at_least=0.5, at_most=1e3)
        check_number("smoothness", self.smoothness, at_least=0, at_most=1e3)
        if self.figure not in (0, 3, 5, 6, 7):
            raise InputError.expected("figure", "3, 5, 6, 7, or 0 for the gain map", self.figure, "choose one of these")
        for what, (low, high) in RANGES.items():
            if not low <= getattr(self, what) <= high:
                raise InputError.expected(
                    labels[what], f"{low} to {high}", getattr(self, what), "enter a number in this range"
                )

    def changed(self, key: str, value: Any) -> MultiplexSettings:
        """Return the settings with one field changed; the size is adjusted to one that the mask supports."""
        if key == "mask":
            return replace(self, mask=value, size=_fitting(value, self.size))
        return replace(self, **{key: value})

    def modulator(self) -> Modulator:
        """Return the chosen modulator; raises `InputError` if there is none."""
        if self.family == "written":
            return _small(modulator_of(self.written))
        return self._made(self.pattern if self.cfa == TYPED else self.cfa, self.mask)

    def named(self) -> str:
        """Return the chosen modulator in the notation of the command line."""
        filters = self.pattern if self.cfa == TYPED else self.cfa
        shadow = f"{self.mask}:{self.size}"
        return {"written": self.written, "cfa": filters, "mask": shadow, "both": f"{shadow}*{filters}"}[self.family]

    def reference(self) -> Modulator:
        """Return the reference; raises `InputError` if there is none."""
        if self.family == "written":
            return _small(modulator_of(self.reference_written))
        return self._made(self.reference_cfa, self.reference_mask)

    def _made(self, filters: str, kind: str) -> Modulator:
        if self.family == "cfa":
            return cfa(filters)
        if self.family == "mask":
            return mask(kind, self.size)
        array = cfa(filters)
        entries = math.prod(math.lcm(self.size, n) for n in array.side) * self.size**2 * array.count
        if entries > MAX_ENTRIES:  # the singular values would take minutes
            raise InputError.expected(
                f"matrix of {kind.replace('_', ' ')} over {array.name}",
                f"up to {MAX_ENTRIES:,} entries",
                f"{entries:,}",
                "reduce Size, or choose other filters",
            )
        return mask(kind, self.size) * array

    def others(self) -> tuple[Modulator, ...]:
        """Return the modulators for comparison, of the same family and size as the chosen one."""
        found = []
        for name in choices_to_compare(self.family):
            if name in self.compared:
                try:
                    mine = self.pattern if self.cfa == TYPED else self.cfa
                    found.append(self._made(name, name) if self.family != "both" else self._made(mine, name))
                except InputError:  # no such mask of this size
                    continue
        return tuple(found)


def _fitting(kind: str, size: int) -> int:
    """Return the supported size of this mask nearest to ``size``."""
    for candidate in sorted(range(1, MAX_SIZE + 1), key=lambda n: abs(n - size)):
        try:
            mask_pattern(kind, candidate)
        except InputError:
            continue
        return candidate
    return size


def _small(modulator: Modulator) -> Modulator:
    if modulator.pixels * modulator.count > MAX_ENTRIES:
        entries = modulator.pixels * modulator.count
        raise InputError.expected(
            f"matrix of {modulator.name}",
            f"up to {MAX_ENTRIES:,} entries",
            f"{entries:,}",
            "choose a smaller modulator",
        )
    return modulator


def choices_to_compare(family: str) -> tuple[str, ...]:
    """Return the names of modulators that can be compared within a family."""
    if family == "written":
        return ()
    return tuple(CFA_PATTERNS) if family == "cfa" else MASKS


@dataclass(frozen=True, eq=False)
class ModulatorPicture:
    """A modulator ready to be drawn.

    Attributes
    ----------
    name
        Name of the modulator.
    pattern, colours
        Transmission ``(rows, columns)`` for the middle view: the mean over colours, or the transmission of
        unmodulated light if samples are not colours. The transmission of R, G and B ``(rows, columns, 3)`` relative to
        its largest value; None for other samples.
    spectrum
        Magnitude of the Fourier weights, averaged over colours, with zero frequency in the middle.
    sigma, pi
        Real parts of Sigma ``(K, J)`` and Pi ``(N, J)``.
    real
        Whether the bases are real.
    """

    name: str
    pattern: Array = field(repr=False)
    colours: Array | None = field(repr=False)
    spectrum: Array = field(repr=False)
    sigma: Array = field(repr=False)
    pi: Array = field(repr=False)
    real: bool = True


def picture(settings: MultiplexSettings) -> ModulatorPicture:
    """Return the images of the chosen modulator."""
    modulator = settings.modulator()
    pattern = modulator.pattern()
    coloured = modulator.colours == ("R", "G", "B")
    if modulator.colours and not coloured and modulator.views == (1, 1):  # Stokes parameters are no transmissions
        pattern = (modulator.matrix @ modulator.light).reshape(*modulator.side, 1)
    top = float(pattern.max()) or 1.0
    sigma, pi = np.asarray(modulator.spatial), np.asarray(modulator.plenoptic)
    return ModulatorPicture(
        modulator.name,
        pattern.mean(-1).round(12),  # no sign for rounding errors
        pattern / top if coloured else None,
        modulator.pattern_spectrum().mean(-1),
        sigma.real.astype(float),
        pi.real.astype(float),
        not (np.iscomplexobj(sigma) or np.iscomplexobj(pi)),
    )
