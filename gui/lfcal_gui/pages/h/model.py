"""Content of the place H: requests for images (intents), and the images that are shown for them. No Qt."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, centre, format_length
from lfcal.camera import Camera
from lfcal.psf import PSFMatrix, computed_words, light_shares, simulated_planes
from lfcal_gui.models import DisplaySettings, Levels, plane_words

if TYPE_CHECKING:
    from lfcal.judge import Pair
    from lfcal.psf.aperture import Aperture

Pixel = tuple[int, int]


@dataclass(frozen=True)
class HIntent:
    """Request for an image of H.

    Attributes
    ----------
    z, y, x
        Depth plane and source position.
    transposed
        Whether HT is the main image.
    show
        ``"measured"``: this H; ``"reference"``: the H with which it is compared.
    pixel
        Pixel (t, s) of the main image under the pointer; None if there is none.
    display
        Scaling and colour map.
    view
        ``"both"``: H and HT; ``"one"`` of them; ``"sum"``: depth-plane sum; ``"difference"``: H, and H minus the
        reference at equal energy; ``"fit"``: measured, model and residual of a fitted pattern.
    """

    z: int = 0
    y: int = 0
    x: int = 0
    transposed: bool = False
    show: str = "measured"
    pixel: Pixel | None = None
    display: DisplaySettings = field(default_factory=DisplaySettings)
    view: str = "both"

    def clamped(self, shape: tuple[int, int, int, int, int], *, reference: bool = True) -> HIntent:
        """Return the intent with all indices inside ``shape``; without a ``reference``, it requests only H."""
        nz, ny, nx, nt, ns = shape
        z, y, x = (min(max(v, 0), n - 1) for v, n in zip((self.z, self.y, self.x), (nz, ny, nx), strict=True))
        pixel = self.pixel
        if pixel is not None and not (0 <= pixel[0] < nt and 0 <= pixel[1] < ns):
            pixel = None
        show, view = self.show if reference else "measured", self.view
        return replace(
            self, z=z, y=y, x=x, pixel=pixel, show=show, view="both" if view == "difference" and not reference else view
        )

    def next_view(self) -> dict[str, Any]:
        """Return the changed fields for the next view: from both to HT, to H, and back to both."""
        if self.view == "both":
            return {"view": "one", "transposed": True}
        return {"view": "one" if self.view == "one" and self.transposed else "both", "transposed": False}

    def moved(self, dy: int, dx: int, period: tuple[int, int]) -> HIntent:
        """Return the intent moved by ``dy``, ``dx`` positions; indices wrap around in the period."""
        return replace(self, y=(self.y + dy) % period[0], x=(self.x + dx) % period[1])


@dataclass(frozen=True, eq=False)
class LoadedPlane:
    """One plane of H in memory.

    Attributes
    ----------
    z
        Index of the plane.
    values
        Values ``(ny, nx, nt, ns)``; for a reference, NaN outside its cutout.
    scale
        For a reference: factor that scales it to the energy of H.
    """

    z: int
    values: NDArray[Any]
    scale: float = 1.0

    def pattern(self, y: int, x: int) -> NDArray[Any]:
        """Return H[z, y, x] as ``(nt, ns)``."""
        pattern: NDArray[Any] = self.values[y, x]
        return pattern

    def transposed_pattern(self, y: int, x: int) -> NDArray[Any]:
        """Return HT[z, y, x] as ``(nt, ns)``, computed directly from H."""
        from lfcal.psf import ht_slice

        return ht_slice(self.values, y, x)


@dataclass(frozen=True, eq=False)
class PlaneData:
    """Data of a plane that has been read.

    Attributes
    ----------
    plane, reference
        Plane of H, and of the reference (None if there is none).
    energy
        Sum of each pattern ``(ny, nx)``.
    depth_sum
        Sum of all patterns ``(nt, ns)``.
    levels
        For each kind of image, the lowest and highest value in the plane, as one scale for all positions. The
        lowest is at most 0; the scale of a difference is symmetric about 0.
    """

    plane: LoadedPlane
    reference: LoadedPlane | None
    energy: NDArray[np.float64]
    depth_sum: NDArray[np.float64]
    levels: Mapping[str, tuple[float, float]]


def read_plane(matrix: PSFMatrix, both: Pair | None, z: int) -> PlaneData:
    """Read plane ``z`` of H, and the plane of the reference paired with it in ``both``."""
    plane = LoadedPlane(z, matrix.plane(z))
    energy = plane.values.sum((2, 3), dtype=np.float64)
    levels = {"measured": _levels_of(plane.values)}
    other = None if both is None else _partner(both, plane)
    if other is not None:
        levels |= {"reference": _levels_of(other.values), "difference": _difference_levels(plane, other)}
    return PlaneData(plane, other, energy, matrix.depth_sum(z), levels)


def _partner(both: Pair, plane: LoadedPlane) -> LoadedPlane | None:
    """Return the plane of the reference paired with ``plane``, with the positions and cutout of H; None if none."""
    z = next((other for own, other in both.planes if own == plane.z), None)
    if z is None:
        return None
    values = both.b.plane(z)
    if any(both.moved):
        values = np.roll(values, (-both.moved[0], -both.moved[1]), (0, 1))
    if both.b.cutout != both.a.cutout:
        whole = np.full(plane.values.shape, np.nan, np.float32)
        put, take = (_middle(one.cutout, both.cutout) for one in (both.a, both.b))
        whole[:, :, *put] = values[:, :, *take]
        values = whole
    return LoadedPlane(plane.z, values, plane_scale(plane.values, values))


def _middle(cutout: tuple[int, int], part: tuple[int, int]) -> tuple[slice, ...]:
    """Return the slices of the ``part`` ``(nt, ns)`` around the source in a cutout."""
    firsts = [centre(n) - centre(m) for n, m in zip(cutout, part, strict=True)]
    return tuple(slice(first, first + m) for first, m in zip(firsts, part, strict=True))


def _levels_of(values: NDArray[Any]) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return min(low, 0.0), high if high > low else low + 1


def _difference_levels(plane: LoadedPlane, reference: LoadedPlane) -> tuple[float, float]:
    """Return the limits of the scale of all differences in a plane, computed row by row."""
    rows = zip(plane.values, reference.values, strict=True)
    top = max(float(np.nanmax(np.abs(_apart(own, other, reference.scale)))) for own, other in rows)
    return -(top or 1.0), top or 1.0


def _apart(own: NDArray[Any], other: NDArray[Any], scale: float) -> NDArray[np.float32]:
    apart: NDArray[np.float32] = own.astype(np.float32) - np.float32(scale) * other.astype(np.float32)
    return apart


@dataclass(frozen=True, eq=False)
class PositionMap:
    """Content of the map of positions.

    Attributes
    ----------
    title, values, unit
        Quantity, its value at each position ``(ny, nx)``, and its unit.
    missing, ringed, aside
        Positions (y, x) ``(n, 2)`` that are crossed out, ringed or framed by a square.
    name
        Name for files of the map.
    levels
        Limits of the colour scale. None: from the values.
    note
        Text next to the title; empty: smallest and largest value.
    lines
        Yields the lines of a table that is copied and saved instead of the values.
    """

    title: str
    values: NDArray[Any]
    unit: str = ""
    missing: NDArray[Any] = field(default_factory=lambda: np.empty((0, 2)))
    ringed: NDArray[Any] = field(default_factory=lambda: np.empty((0, 2)))
    aside: NDArray[Any] = field(default_factory=lambda: np.empty((0, 2)))
    name: str = "period"
    levels: Levels | None = None
    note: str = ""
    lines: Callable[[str], Iterable[str]] | None = None

    @property
    def range_words(self) -> str:
        """Text next to the title."""
        known = self.values[np.isfinite(self.values)]
        ends = (known.min(), known.max()) if known.size else ()
        between = " to ".join(f"{v:.3g}" if abs(v) < 1000 else f"{v / 1000:.3g}k" for v in ends)
        return self.note or f"{between} {self.unit}".strip()


def light_map(data: PlaneData, worst: Iterable[tuple[int, ...]], missing: NDArray[Any], unit: str) -> PositionMap:
    """Return the map of the light of each pattern, with ``missing`` positions crossed out and ``worst`` ones ringed."""
    return PositionMap("Light by position", data.energy, unit, np.argwhere(missing), places_in(data.plane.z, worst))


def places_in(z: int, places: Iterable[tuple[int, ...]]) -> NDArray[np.float64]:
    """Return those positions (z, y, x) that are in plane ``z``, as (y, x) ``(n, 2)``."""
    return np.array([place[1:] for place in places if place[0] == z], np.float64).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class HPicture:
    """Main and linked image to draw, with titles and cursors (pixels (t, s); None: no cursor).

    The linked image shows the source position ``linked_position`` (y, x). It is a difference if ``signed``.
    """

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
    """Return the position and pixel in HT of the entry of H at ``position`` and ``pixel``.

    HT[z, y', x', t', s'] = H[z, y, x, t, s] with y' = (y + t - ct) mod ny, t' = nt-1-t, and likewise for x and s;
    (ct, cs) is the centre of the cutout. The relation is its own inverse, so it also leads from HT to H.
    """
    y = (position[0] + pixel[0] - centre(cutout[0])) % period[0]
    x = (position[1] + pixel[1] - centre(cutout[1])) % period[1]
    return (y, x), turn_pixel(pixel, cutout)


def resolve(intent: HIntent, plane: LoadedPlane, reference: LoadedPlane | None = None) -> HPicture:
    """Return the images for ``intent`` from the loaded plane (and that of the reference).

    Without a pixel under the pointer, the linked image is the other matrix at the same position. With a pixel, it is
    the pattern that contains this pixel in the other matrix, with the entry marked. In the view ``"difference"``, it is
    the difference from the reference.
    """
    ny, nx, nt, ns = plane.values.shape
    here, pixel = (intent.y, intent.x), intent.pixel
    names = ("HT", "H") if intent.transposed else ("H", "HT")
    if intent.view == "difference" and reference is not None:
        own, other = (_pattern(one, here, intent.transposed) for one in (plane, reference))
        at = f"position y {here[0]}, x {here[1]}"
        apart = _apart(own, other, reference.scale)
        return HPicture(own, apart, f"{names[0]}, {at}", f"{names[0]} minus the other H", pixel, pixel, True, here)
    shown, what = (reference, "Other H: ") if intent.show == "reference" and reference is not None else (plane, "")
    there, mark = (here, None) if pixel is None else linked_pixel(here, pixel, (ny, nx), (nt, ns))
    return HPicture(
        _pattern(shown, here, intent.transposed),
        _pattern(shown, there, not intent.transposed),
        f"{what}{names[0]}, position y {here[0]}, x {here[1]}",
        f"{what}{names[1]}, position y {there[0]}, x {there[1]}",
        pixel,
        mark,
        False,
        there,
    )


def _pattern(plane: LoadedPlane, at: tuple[int, int], transposed: bool) -> NDArray[Any]:
    return plane.transposed_pattern(*at) if transposed else plane.pattern(*at)


def plane_scale(own: NDArray[Any], other: NDArray[Any]) -> float:
    """Return the factor that scales ``other`` to the energy of ``own``, estimated from some positions."""
    step = max(1, own.shape[1] // 8)
    sample = other[::step, ::step]
    known = np.isfinite(sample)
    light = float(own[::step, ::step].sum(where=known, dtype=np.float64))
    there = float(sample.sum(where=known, dtype=np.float64))
    return light / there if there else 0.0


# -- words -------------------------------------------------------------------------------------------------
def unit_of(matrix: PSFMatrix) -> str:
    """Return quantity and unit of the values of H; a simulated H is not in counts."""
    return "fraction of the light" if light_shares(matrix.provenance) else "intensity (counts)"


def shown_unit(intent: HIntent, matrix: PSFMatrix, reference: PSFMatrix | None) -> str:
    """Return quantity and unit of the values shown; a difference is scaled to the energy of H."""
    other = intent.show == "reference" and intent.view != "difference"
    return unit_of(reference if other and reference is not None else matrix)


def unit_word(unit: str) -> str:
    """Return what follows a value whose quantity and unit are ``unit``."""
    return "counts" if "counts" in unit else "of the light"


def pixel_words(picture: HPicture, pixel: Pixel, unit: str) -> tuple[str, str]:
    """Return pixel (t, s) of the main image and its value in ``unit`` as text; also a shorter text for a difference."""
    t, s = pixel
    word = unit_word(unit)
    whole = f"t {t}, s {s}: {picture.main[t, s]:.5g} {word}"
    if not picture.signed:
        return whole, ""
    apart = picture.linked[t, s]
    return f"{whole}, {apart:+.4g} {word} relative to the other H", f"t {t}, s {s}: Δ {apart:+.4g} {word}"


def _virtual_words(camera: Camera | None, depth_um: float) -> str:
    if camera is None or not camera.has_lattice:
        return ""
    try:
        return f", v = {camera.virtual_depth(depth_um):.2f}"
    except InputError:  # the H of others may bring another camera
        return ", where the camera of H sees nothing"


def place_words(matrix: PSFMatrix, intent: HIntent) -> tuple[str, str]:
    """Return the names of plane and position."""
    depth = float(matrix.known_depths[intent.z])
    known = f"z = {format_length(depth)}{_virtual_words(matrix.camera, depth)}"
    at = known if matrix.knows_depths else "depth not stated"
    at = at.replace(" ", "\u00a0").replace(",\u00a0", ", ")  # no line breaks within it
    ny, nx = matrix.period
    return (
        f"{plane_words(intent.z, len(matrix))}: {at}",
        f"Position y {intent.y}, x {intent.x} of {ny} × {nx}",
    )


# -- the aperture in words -------------------------------------------------------------------------------
UNKNOWN = "—"
SMALL = "style='font-size:9pt'"
GAP = "style='padding-right:6px'"


def expected_in(matrix: PSFMatrix, z: int) -> Aperture | None:
    """Return the aperture expected from the camera in plane ``z``; None without a camera."""
    from lfcal.psf.aperture import expected_aperture

    if matrix.camera is None:
        return None
    return expected_aperture(matrix.camera, float(matrix.depths[z]), matrix.cutout, matrix.pixel_scale)


MAIN = ("Shape", "Blades", "Rotation", "Apothem", "Confidence")
"""Names of the most important numbers of an aperture."""


def aperture_words(aperture: Aperture, expected: Aperture | None = None, names: Collection[str] = MAIN) -> str:
    """Return the numbers ``names`` (if empty: all) of a fitted and an expected aperture as rich text.

    If the fit refuses a result, the reason comes first.
    """
    from lfcal.psf.aperture import REFUSALS

    refused = f"<p><b>{aperture.refusal}</b>: {REFUSALS[aperture.refusal]}</p>" if aperture.refusal else ""
    if aperture.confident and aperture.fault:
        refused = f"<p><b>{aperture.fault}</b></p>"
    found = {name: value for name, value in _numbers(aperture).items() if not names or name in names}
    if expected is None:
        cells = "".join(f"<tr><td {GAP}>{name}</td>{_value(value)}</tr>" for name, value in found.items())
        return f"{refused}<table cellspacing='0' cellpadding='0' {SMALL}>{cells}</table>"
    there = {name: _bare(text) for name, text in _numbers(expected).items()}
    there |= dict.fromkeys(("Edge blur", "Ellipticity", "Confidence"), UNKNOWN)
    head = f"<tr><td></td><td {GAP}>fitted</td><td>expected</td></tr>"
    rows = "".join(
        f"<tr><td {GAP}>{name}</td>{_value(value)}<td>{there[name]}</td></tr>" for name, value in found.items()
    )
    return f"{refused}<table cellspacing='0' cellpadding='0' {SMALL}>{head}{rows}</table>"


def _bare(text: str) -> str:
    """Return a number without its unit, which the number next to it shows."""
    return text.removesuffix(" px").removesuffix(" px²")


def _value(text: str) -> str:
    # numbers do not wrap, words may
    wrap = "normal" if text[0].isalpha() else "nowrap"
    return f"<td style='white-space:{wrap}; padding-right:6px'><b>{text}</b></td>"


def _numbers(aperture: Aperture) -> dict[str, str]:
    from lfcal.psf.aperture import KINDS, with_error

    row, column = aperture.centre
    # do not name a number of blades that the fit rejects
    certain = aperture.confident and aperture.blades > 0
    sigma = aperture.curvature_sigma
    error = f" ± {sigma:.2f}" if np.isfinite(sigma) and sigma > 0 else ""

    def seen(text: str) -> str:  # without a visible outline nothing was measured
        return text if aperture.seen else UNKNOWN

    return {
        "Shape": KINDS[aperture.kind],
        "Blades": f"{aperture.blades}" if certain else UNKNOWN,
        "Rotation": f"{np.degrees(aperture.rotation_rad):.1f}°" if certain else UNKNOWN,
        "Centre t": seen(f"{row:.2f} px"),
        "Centre s": seen(f"{column:.2f} px"),
        "Apothem": seen(f"{with_error(aperture.apothem_px, aperture.apothem_sigma_px, 2)} px"),
        "Area": seen(f"{with_error(aperture.area_px2, aperture.area_sigma_px2, 0)} px²"),
        "Curvature": f"{aperture.curvature:.2f}{error}" if certain else UNKNOWN,
        "Edge blur": seen(f"{aperture.blur_px:.2f} px"),
        "Ellipticity": seen(f"{100 * aperture.ellipticity:.1f} %"),
        "Confidence": f"{100 * aperture.confidence:.0f} %" if aperture.confident else UNKNOWN,
    }


def made_words(matrix: PSFMatrix, z: int) -> str:
    """Return engine, sampling, processor time and error of a simulated plane as lines of text; empty if not stated."""
    lines = computed_words([simulated_planes(matrix.provenance, len(matrix))[z]])
    return "\n".join(words.partition(": ")[2].replace("; ", "\n").replace(" x ", " × ") for words in lines)


def aperture_tip(z: int, depth_um: float, count: int, fitted: Aperture | None, expected: Aperture | None) -> str:
    """Return a description of the aperture of plane ``z`` of ``count`` planes, as lines of text."""
    lines = [plane_words(z, count) + (f": z = {format_length(depth_um)}" if math.isfinite(depth_um) else "")]
    lines += [f"{what}: {one.describe()}" for what, one in (("fitted", fitted), ("expected", expected)) if one]
    return "\n".join(lines)
