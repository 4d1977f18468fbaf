"""What the PSF page shows: intent in, frozen picture out. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, centre, format_length
from lfcal.camera import Camera
from lfcal.psf import PSFMatrix, light_shares
from lfcal_gui.models import DisplaySettings, plane_words

__all__ = [
    "LoadedPlane",
    "PSFIntent",
    "PSFPicture",
    "Pixel",
    "PlaneData",
    "linked_pixel",
    "pixel_words",
    "place_words",
    "read_plane",
    "resolve",
    "shown_unit",
    "turn_pixel",
    "unit_of",
]

Pixel = tuple[int, int]


@dataclass(frozen=True)
class PSFIntent:
    """What the user asked for.

    Attributes
    ----------
    z, y, x
        Depth plane and source position.
    transposed
        Whether HT is the main picture.
    show
        ``"measured"``, ``"reference"`` or ``"difference"`` (measured - reference, both of unit energy).
    pixel
        Pixel (t, s) the pointer is on in the main picture, None: none.
    display
        Scaling and colour map.
    view
        ``"both"``: H and HT, ``"one"`` of them, or ``"sum"``: that of the plane.
    """

    z: int = 0
    y: int = 0
    x: int = 0
    transposed: bool = False
    show: str = "measured"
    pixel: Pixel | None = None
    display: DisplaySettings = field(default_factory=DisplaySettings)
    view: str = "both"

    def clamped(self, shape: tuple[int, int, int, int, int], *, reference: bool = True) -> PSFIntent:
        """Return the intent with every index inside a matrix of ``shape``; without a ``reference`` H alone is shown."""
        nz, ny, nx, nt, ns = shape
        z, y, x = (min(max(v, 0), n - 1) for v, n in zip((self.z, self.y, self.x), (nz, ny, nx), strict=True))
        pixel = self.pixel
        if pixel is not None and not (0 <= pixel[0] < nt and 0 <= pixel[1] < ns):
            pixel = None
        return replace(self, z=z, y=y, x=x, pixel=pixel, show=self.show if reference else "measured")

    def moved(self, dy: int, dx: int, period: tuple[int, int]) -> PSFIntent:
        """Return the intent one or more positions further; the period wraps around."""
        return replace(self, y=(self.y + dy) % period[0], x=(self.x + dx) % period[1])


@dataclass(frozen=True, eq=False)
class LoadedPlane:
    """One plane of H in memory: values ``(ny, nx, nt, ns)`` as stored, with their scale and offset."""

    z: int
    values: NDArray[Any]

    def pattern(self, y: int, x: int) -> NDArray[Any]:
        """Return H[z, y, x] as ``(nt, ns)``."""
        pattern: NDArray[Any] = self.values[y, x]
        return pattern

    def transposed_pattern(self, y: int, x: int) -> NDArray[Any]:
        """Return HT[z, y, x] as ``(nt, ns)``, computed from H at once."""
        from lfcal.psf import ht_slice

        return ht_slice(self.values, y, x)


@dataclass(frozen=True, eq=False)
class PlaneData:
    """What is known of a plane once it is read.

    Attributes
    ----------
    plane, reference
        The plane of H, and of the reference where there is one.
    energy
        ``(ny, nx)`` sum of each pattern.
    depth_sum
        ``(nt, ns)`` sum of all patterns.
    levels
        For what is shown of `PSFIntent` lowest and highest value in the plane: one scale for all its positions. The
        lowest is at most 0; of a difference both are as far from it.
    """

    plane: LoadedPlane
    reference: LoadedPlane | None
    energy: NDArray[np.float64]
    depth_sum: NDArray[np.float64]
    levels: Mapping[str, tuple[float, float]]


def read_plane(matrix: PSFMatrix, reference: PSFMatrix | None, z: int) -> PlaneData:
    """Read plane ``z`` of H and of the reference."""
    plane = LoadedPlane(z, matrix.plane(z))
    other = None if reference is None else LoadedPlane(z, reference.plane(z))
    energy = plane.values.sum((2, 3), dtype=np.float64)
    levels = {"measured": _levels_of(plane.values)}
    if other is not None:
        levels |= {"reference": _levels_of(other.values), "difference": _difference_levels(plane, other)}
    return PlaneData(plane, other, energy, matrix.depth_sum(z), levels)


def _levels_of(values: NDArray[Any]) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    return min(low, 0.0), high if high > low else low + 1


def _difference_levels(plane: LoadedPlane, reference: LoadedPlane) -> tuple[float, float]:
    """Return the ends of the scale of all differences of a plane, found row by row of positions."""
    scale, top = plane_scale(plane, reference), 0.0
    for own, other in zip(plane.values, reference.values, strict=True):
        top = max(top, float(np.abs(own.astype(np.float32) - np.float32(scale) * other.astype(np.float32)).max()))
    return -(top or 1.0), top or 1.0


@dataclass(frozen=True, eq=False)
class PSFPicture:
    """What is drawn: the main picture, the linked one, their titles and cursors."""

    main: NDArray[Any]
    linked: NDArray[Any]
    main_title: str
    linked_title: str
    main_cursor: Pixel | None
    linked_cursor: Pixel | None
    signed: bool
    linked_position: tuple[int, int]


def turn_pixel(pixel: Pixel, cutout: tuple[int, int]) -> Pixel:
    """Return the pixel turned by 180 degrees about the cutout's centre."""
    return cutout[0] - 1 - pixel[0], cutout[1] - 1 - pixel[1]


def linked_pixel(
    position: tuple[int, int], pixel: Pixel, period: tuple[int, int], cutout: tuple[int, int]
) -> tuple[tuple[int, int], Pixel]:
    """Return where the entry of H at ``position`` and ``pixel`` stands in HT: position and pixel there.

    HT[z, y', x', t', s'] = H[z, y, x, t, s] with y' = (y + t - ct) mod ny, t' = nt-1-t, and so for x and s. The
    relation is its own inverse, so it leads from HT to H as well.
    """
    y = (position[0] + pixel[0] - centre(cutout[0])) % period[0]
    x = (position[1] + pixel[1] - centre(cutout[1])) % period[1]
    return (y, x), turn_pixel(pixel, cutout)


def resolve(intent: PSFIntent, plane: LoadedPlane, reference: LoadedPlane | None = None) -> PSFPicture:
    """Return what to draw for ``intent`` from the loaded plane (and that of the reference).

    Without a pixel under the pointer the linked picture is the other matrix at the same position; with one it
    is the pattern that this pixel belongs to, with the entry marked.
    """
    ny, nx, nt, ns = plane.values.shape
    here = (intent.y, intent.x)
    there, mark = (here, None) if intent.pixel is None else linked_pixel(here, intent.pixel, (ny, nx), (nt, ns))
    names = ("HT", "H") if intent.transposed else ("H", "HT")
    main = _shown(intent, plane, reference, here, intent.transposed)
    linked = _shown(intent, plane, reference, there, not intent.transposed)
    what = {"measured": "", "reference": "Reference: ", "difference": "Difference: "}[intent.show]
    return PSFPicture(
        main,
        linked,
        f"{what}{names[0]}, position y {here[0]}, x {here[1]}",
        f"{what}{names[1]}, position y {there[0]}, x {there[1]}",
        intent.pixel,
        mark,
        intent.show == "difference",
        there,
    )


def _shown(
    intent: PSFIntent, plane: LoadedPlane, reference: LoadedPlane | None, at: tuple[int, int], transposed: bool
) -> NDArray[Any]:
    def of(loaded: LoadedPlane) -> NDArray[Any]:
        return loaded.transposed_pattern(*at) if transposed else loaded.pattern(*at)

    if intent.show == "measured" or reference is None:
        return of(plane)
    other = of(reference)
    if intent.show == "reference":
        return other
    measured = of(plane)
    scale = plane_scale(plane, reference)
    difference: NDArray[Any] = measured.astype(np.float32) - np.float32(scale) * other.astype(np.float32)
    return difference


def plane_scale(plane: LoadedPlane, reference: LoadedPlane) -> float:
    """Return the factor that brings the reference to the energy of the plane (from a sample of positions)."""
    step = max(1, plane.values.shape[1] // 8)
    own = float(plane.values[::step, ::step].sum(dtype=np.float64))
    other = float(reference.values[::step, ::step].sum(dtype=np.float64))
    return own / other if other else 0.0


# -- words -------------------------------------------------------------------------------------------------
def unit_of(matrix: PSFMatrix) -> str:
    """Return what the values of H are: a simulated one has no counts."""
    return "share of the light" if light_shares(matrix.provenance) else "intensity (counts)"


def shown_unit(intent: PSFIntent, matrix: PSFMatrix, reference: PSFMatrix | None) -> str:
    """Return what the values shown are; a difference is taken at the light of H."""
    return unit_of(reference if intent.show == "reference" and reference is not None else matrix)


def pixel_words(picture: PSFPicture, pixel: Pixel, unit: str) -> str:
    """Return the pixel (t, s) of the main picture in words, its value in ``unit``."""
    t, s = pixel
    return f"t {t}, s {s}: {picture.main[t, s]:.5g} {'counts' if 'counts' in unit else 'of the light'}"


def _virtual_words(camera: Camera | None, depth_um: float) -> str:
    if camera is None:
        return ""
    try:
        return f", v = {camera.virtual_depth(depth_um):.2f}"
    except InputError:  # the H of others may bring another camera
        return ", where its camera sees nothing"


def place_words(matrix: PSFMatrix, intent: PSFIntent) -> tuple[str, str]:
    """Return plane and position in words."""
    depth = float(matrix.known_depths[intent.z])
    known = f"z = {format_length(depth)}{_virtual_words(matrix.camera, depth)}"
    at = known if matrix.knows_depths else "depth not stated"
    at = at.replace(" ", "\u00a0").replace(",\u00a0", ", ")  # no line ends in it
    ny, nx = matrix.period
    return (
        f"{plane_words(intent.z, len(matrix))}: {at}",
        f"Position y {intent.y}, x {intent.x} of {ny} × {nx} px",
    )
