"""What the Multiplexing page asks for and shows of modulators: settings, pictures, numbers, gain curves. No Qt."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_number
from lfcal.multiplex import CFA_PATTERNS, MASKS, Modulator, cfa, mask, mask_pattern, modulator_of, parse_pattern
from lfcal_gui.models import PageSettings
from lfcal_gui.pages.multiplex.model_fields import FIELDS, MAX_SIZE, SEARCH_FIELDS, TYPED

RANGES = {"search_size": (2, 13), "levels": (2, 16), "kinds": (1, 6), "crosstalk": (0, 0.4), "least_light": (0, 0.99)}
MAX_ENTRIES = 350_000
"""Entries of the matrix A of a mask over colour filters."""
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
    "Clipped or dead pixels are left out, so the spatial route interpolates linearly. To choose a filter, use all "
    "pixels: switch Leave out clipped off, and name no dead pixels"
)
"""Why there is no filter to choose."""


def used_by(settings: MultiplexSettings, key: str, *, colour: bool = False) -> bool:
    """Return whether the field ``key`` matters; ``colour``: the opened image is in colour, a scene and no frame."""
    if key == "weighted":
        return settings.scene == "live" or (settings.scene == "image" and not colour)
    if key == "filter":
        return settings.route != "general" and not weighs(settings, colour=colour)
    return key not in _USES or _USES[key](settings)


def weighs(settings: MultiplexSettings, *, colour: bool = False) -> bool:
    """Return whether pixels of the frame have weights; ``colour`` as in `used_by`."""
    clipped = settings.weighted and used_by(settings, "weighted", colour=colour)
    return clipped or (bool(settings.dead) and used_by(settings, "dead"))


def why_unused(settings: MultiplexSettings, key: str, *, colour: bool = False) -> str:
    """Return the reason why `used_by` refuses a field, if its tip does not explain it."""
    linear = key == "filter" and settings.route != "general" and weighs(settings, colour=colour)
    return LINEAR if linear else ""


@dataclass(frozen=True)
class MultiplexSettings(PageSettings):
    """What the user chose; see `FIELDS`.

    Attributes
    ----------
    compared
        Names of filter arrays and masks whose gain is compared with that of the modulator.
    image
        Opened image, or empty.
    right
        Third picture: ``"difference"`` of the routes or ``"truth"``.
    figure, own_camera
        Which figure of the paper is shown (0: a map of gains), and whether with the project's camera in place of
        the paper's.
    route, dead, white, transmissions, spacing, smoothness
        How samples are found (`lfcal_gui.pages.multiplex.model_routes`); files are paths, or empty.
    sought, search_size, levels, kinds, crosstalk, least_light
        Of the search (`lfcal_gui.pages.multiplex.model_search`).
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
                raise InputError.expected(labels.get(key, key), " or ".join(values), getattr(self, key), "choose")
        parse_pattern(self.pattern)
        if not 1 <= self.size <= MAX_SIZE:
            raise InputError.expected("size (px)", f"1 to {MAX_SIZE}", self.size, "correct it")
        mask_pattern(self.mask, self.size)
        if not 0 < self.gain < 1e6:
            raise InputError.expected("amplifier gain", "above 0", self.gain, "correct it")
        if self.spacing is not None:
            check_number("node spacing (px)", self.spacing, at_least=0.5, at_most=1e3)
        check_number("smoothness", self.smoothness, at_least=0, at_most=1e3)
        if self.figure not in (0, 3, 5, 6, 7):
            raise InputError.expected("figure", "3, 5, 6, 7, or 0 for the gain map", self.figure, "choose one of these")
        for what, (low, high) in RANGES.items():
            if not low <= getattr(self, what) <= high:
                raise InputError.expected(labels[what], f"{low} to {high}", getattr(self, what), "correct it")

    def changed(self, key: str, value: Any) -> MultiplexSettings:
        """Return the settings with one field changed; a mask without this size gets its nearest size."""
        if key == "mask":
            return replace(self, mask=value, size=_fitting(value, self.size))
        return replace(self, **{key: value})

    def modulator(self) -> Modulator:
        """Return the chosen modulator; raises `InputError` if there is none."""
        if self.family == "written":
            return _small(modulator_of(self.written))
        return self._made(self.pattern if self.cfa == TYPED else self.cfa, self.mask)

    def named(self) -> str:
        """Return the chosen modulator as the command line writes it."""
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
                f"matrix of {kind} over {array.name}", f"up to {MAX_ENTRIES} entries", entries, "choose a smaller mask"
            )
        return mask(kind, self.size) * array

    def others(self) -> tuple[Modulator, ...]:
        """Return the modulators to be compared with, of the family and the size of the chosen one."""
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
    """Return the size nearest to ``size`` at which such a mask exists."""
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
            f"matrix of {modulator.name}", f"up to {MAX_ENTRIES} entries", entries, "a smaller one"
        )
    return modulator


def choices_to_compare(family: str) -> tuple[str, ...]:
    """Return the names that can be compared within a family."""
    if family == "written":
        return ()
    return tuple(CFA_PATTERNS) if family == "cfa" else MASKS


@dataclass(frozen=True, eq=False)
class ModulatorPicture:
    """A modulator ready to be drawn.

    Attributes
    ----------
    name
        Its name.
    pattern, colours
        Transmission ``(rows, columns)`` for the middle view: the mean over colours, or that of unmodulated light if
        samples are not colours. The same as colours ``(rows, columns, 3)``; None for a light field of one colour.
    spectrum
        Magnitude of its Fourier weights, mean over colours, zero frequency in the middle.
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
    """Return the chosen modulator as pictures."""
    modulator = settings.modulator()
    pattern = modulator.pattern()
    coloured = modulator.colours == ("R", "G", "B")
    if modulator.colours and not coloured and modulator.views == (1, 1):  # Stokes parameters are no transmissions
        pattern = (modulator.matrix @ modulator.light).reshape(*modulator.side, 1)
    top = float(pattern.max()) or 1.0
    sigma, pi = np.asarray(modulator.spatial), np.asarray(modulator.plenoptic)
    return ModulatorPicture(
        modulator.name,
        pattern.mean(-1),
        pattern / top if coloured else None,
        modulator.pattern_spectrum().mean(-1),
        sigma.real.astype(float),
        pi.real.astype(float),
        not (np.iscomplexobj(sigma) or np.iscomplexobj(pi)),
    )
