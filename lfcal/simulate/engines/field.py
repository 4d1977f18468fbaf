"""The main lens's field on the lenslet array, tabulated once per plane by one or two FFTs.

With the pupil P(u), u in units of the radius of the disc f/(2 Nw), the field about a source image is

    U(X) = integral P(-f 2 lambda Nw) exp(i pi lambda a' f^2 + 2 pi i f.X) df.

Away from the native plane (E-mode), the sphere that converges to the image is removed, U = exp(-i pi X^2 / (lambda
a')) E(X). E is the Fresnel pattern of the iris's shadow over the distance a'. Its spectrum is the polygon's analytic
transform times a chirp. Near the native plane (U-mode), the pupil is sampled instead and defocus is a phase on it. a'
= 0 is not a special case, because 1/a' is never computed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft as sf
from numpy.typing import NDArray

from lfcal.base import InputError, any_of
from lfcal.simulate._symmetry import folded
from lfcal.simulate.engines._debye import DIPOLE_FIELDS, DebyeField, debye_fields, radial_field
from lfcal.simulate.engines._polygon import Points, area, clip, disc_transform, iris_outline, spectrum
from lfcal.simulate.engines._radial import Radial, focus_integral, parity_spline
from lfcal.simulate.engines.extent import SWITCH, SWITCH_EXACT
from lfcal.simulate.engines.masks import taper
from lfcal.simulate.engines.zernike import zernike_wavefront
from lfcal.simulate.scene import Scene

__all__ = [
    "DIPOLE_MODES",
    "FieldTable",
    "choose_mode",
    "field_modes",
    "field_spectrum",
    "field_table",
    "wavefront_waves",
]

MAX_SAMPLES = 8192
"""Largest side of a table: 0.5 GB in single precision, 2.5 GB while it is computed."""

STEEPEST = 0.5
"""Square of the sine up to which a lens law changes the amplitude, as for f/0.7."""

EDGE_PARTS = 4
"""Number of parts of an iris's edge if a lens law bends it: accurate to 0.1 % of its radius at f/5."""

PART = 1_000_000
"""Number of samples of a table that are processed together in steps that need many temporary arrays."""

DIPOLE_MODES: dict[str, DebyeField] = {f"D{f.order}{'s' if f.sine else 'c'}": f for f in DIPOLE_FIELDS}
"""Field of a vectorial scene for each mode: D0c, D1c, D1s, D2c, D2s."""

_SQUARE = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])

Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class FieldTable:
    """The main lens's field on the array, on a square grid about the source's image.

    The energy that passes the iris is 1 without vignetting.

    Attributes
    ----------
    mode
        ``"E"``: the field without the converging spherical wave; ``"U"``: the full field; ``"D"``: the Debye field of a
        microscope; one of `DIPOLE_MODES`: one of the fields of a vectorial scene.
    dx_um
        Sample spacing (µm).
    values
        ``(n, n)`` complex, rows along y; the chief ray meets sample (n // 2, n // 2).
    half_um
        Distance from the source's image up to which the values are valid (µm).
    """

    mode: str
    dx_um: float
    values: Complex
    half_um: float


def choose_mode(scene: Scene) -> str:
    """Return the mode of propagation (see `FieldTable`): ``"D"`` for a microscope, else ``"E"`` or ``"U"``.

    ``"E"`` is used if `Scene.fresnel_number` is at least 12, or 8 with `Scene.exact_rays`, and ``"U"`` otherwise.
    """
    if scene.objective is not None:
        return "D"
    return "E" if scene.fresnel_number >= (SWITCH_EXACT if scene.exact_rays else SWITCH) else "U"


def field_modes(scene: Scene) -> tuple[str, ...]:
    """Return the modes of the fields whose intensities add up to the light of a point (see `FieldTable`).

    There is one mode, or several for a vectorial scene.
    """
    if scene.objective is None or not scene.vectorial:
        return (choose_mode(scene),)
    carrying = debye_fields(scene)
    return tuple(mode for mode, field in DIPOLE_MODES.items() if field in carrying)


def wavefront_waves(scene: Scene, ux: NDArray[np.float64], uy: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the aberration (waves) at pupil points (ux, uy) in pupil radii, including that of exact defocus.

    The result is None if the scene has neither. At the distance u from the pupil's centre, the angle theta has the sine
    s = u/(2 N), with N = `Scene.rim_f_number`. Exact defocus adds a' s^4 / (2 lambda (1 + sqrt(1 - s^2))^2), with a' =
    `Scene.reduced_image_um` and the wavelength lambda. This is the difference between a'(1 - cos theta) / lambda and
    its parabola, without cancellation.
    """
    if not scene.wavefront and not scene.exact_defocus:
        return None
    rho2 = ux * ux + uy * uy
    total = np.zeros(np.broadcast_shapes(ux.shape, uy.shape))
    if scene.exact_defocus:
        sine2 = np.minimum(rho2 / (2 * scene.rim_f_number) ** 2, 1.0)
        total += scene.reduced_image_um / scene.wavelength_um * sine2**2 / (2 * (1 + np.sqrt(1 - sine2)) ** 2)
    return total + zernike_wavefront(scene.wavefront, ux, uy) if scene.wavefront else total


def pupil_amplitude(scene: Scene, rho2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the amplitude, 1 in mean square over the unit disc, at squared relative sines ``rho2``.

    The relative sine rho is the sine of a ray's angle theta divided by that of the rim ray.

    With q = `Scene.lens_law`, an area of the uniformly lit pupil is (1 - q sin² theta)^-2 times the area that its rays
    cover in sines.
    """
    q, rim2 = scene.lens_law, 1 / (2 * scene.rim_f_number) ** 2
    # far outside of the pupil, such a ray may not exist
    found: NDArray[np.float64] = math.sqrt(1 - q * rim2) / (1 - q * np.minimum(rim2 * rho2, STEEPEST))
    return found


def _by_sine(scene: Scene, outline: Points) -> Points:
    """Return the outline of the pupil by the sines of its rays, 1 at the rim; edges that bend are drawn in parts."""
    if scene.lens_law == 0:
        return outline
    if not scene.iris.circular:
        parts = np.arange(EDGE_PARTS)[:, None, None] / EDGE_PARTS
        outline = np.swapaxes((1 - parts) * outline + parts * np.roll(outline, -1, 0), 0, 1).reshape(-1, 2)
    square = scene.lens_law / (2 * scene.f_number) ** 2
    found: Points = outline * np.sqrt((1 + square) / (1 + square * np.square(outline).sum(1, keepdims=True)))
    return found


def field_table(scene: Scene, dx: float, half: float, mode: str | None = None) -> FieldTable:
    """Return the main lens's field on the array, up to the distance ``half`` (µm) from the source's image.

    The sample spacing is ``dx`` (µm). The mode of propagation ``mode`` is as in `FieldTable`. None: that of
    `choose_mode`.

    Raises
    ------
    InputError
        If the table would need more than `MAX_SAMPLES` along a side. Also if the iris's diffraction is off in mode
        ``"U"``, ``dx`` is too large for this mode, or a mode of a microscope does not match `Scene.vectorial`.
    """
    chosen = mode or choose_mode(scene)
    made, transformed = _made(scene, dx, half, chosen)
    return FieldTable(chosen, dx, sf.ifft2(made, overwrite_x=True) if transformed else made, half)


def field_spectrum(scene: Scene, dx: float, half: float, mode: str | None = None) -> Complex:
    """Return the discrete Fourier transform of the values of `field_table`, without computing the table.

    The arguments are those of `field_table`.
    """
    made, transformed = _made(scene, dx, half, mode or choose_mode(scene))
    return made if transformed else sf.fft2(made, overwrite_x=True)


def _made(scene: Scene, dx: float, half: float, mode: str) -> tuple[Complex, bool]:
    """Return the values of a table or their discrete Fourier transform (True), whichever is computed first."""
    if mode[0] == "D":
        return _debye(scene, dx, half, mode), False
    outline = _by_sine(scene, iris_outline(scene.iris))
    if mode == "U" and not scene.main_diffraction:
        number, limit = scene.fresnel_number, SWITCH_EXACT if scene.exact_rays else SWITCH
        raise InputError.expected(
            "diffraction at the main iris (main_diffraction)",
            f"on, because the Fresnel number of this plane, {number:.3g}, is below {limit:g}",
            "off",
            "switch it on",
        )
    if len(outline) < 3:
        return np.zeros((4, 4), np.complex128), True
    make = _envelope if mode == "E" else _near_field
    return make(scene, dx, half, outline)


def _side(length: float, dx: float) -> int:
    n = 2 * math.ceil(length / (2 * dx) + 4)
    if n > MAX_SAMPLES:
        raise InputError.expected(
            "sampled field of the main lens",
            f"at most {MAX_SAMPLES} samples on each side",
            n,
            "use a smaller cutout, or the level geometric",
        )
    size = int(sf.next_fast_len(n))
    # an even number, so that alternating signs are sufficient to move the origin to sample n // 2
    return size if size % 2 == 0 else _side((n + 1) * dx, dx)


def _centre(spectrum: Complex) -> None:
    """Move the origin of the field with this spectrum to sample n // 2 (n even)."""
    spectrum[1::2] *= -1
    spectrum[:, 1::2] *= -1


def _envelope(scene: Scene, dx: float, half: float, outline: Points) -> tuple[Complex, bool]:
    """Return the field in E-mode: the analytic spectrum of the iris's shadow, times a chirp."""
    a, lam = scene.reduced_image_um, scene.wavelength_um
    to_shadow = a / (2 * scene.rim_f_number)
    level = 1 / (math.sqrt(math.pi) * abs(to_shadow))  # unit energy through an iris of area pi in pupil units
    fringe = math.sqrt(lam * abs(a))
    shadow = outline * to_shadow
    reach = float(np.abs(shadow).max())
    box = min(half + 8 * fringe, 0.5 * MAX_SAMPLES * dx - 4.5 * fringe)
    local = max(half, box) < reach  # only a part of a large shadow is computed; the rest fades out beyond it
    if local:
        shadow = clip(shadow, box * _SQUARE)
        reach = box
        if scene.wavefront == () and not scene.exact_defocus and area(shadow) > 4 * box * box * (1 - 1e-12):
            n = _side(2 * half, dx)  # the part contains no edge
            return np.full((n, n), level, np.complex128), False
    n = _side(2 * (max(reach, half) + 4 * fringe), dx)
    f = sf.fftfreq(n, dx)
    if scene.iris.circular and not local:
        g = _disc_spectrum(abs(to_shadow), f)
    elif len(shadow) < 3:
        return np.zeros((n, n), np.complex128), True
    else:
        g = spectrum(shadow, f, f)
    _centre(g)
    x = (np.arange(n, dtype=np.float64) - n // 2) * dx
    aberrated = bool(scene.wavefront) or scene.exact_defocus
    if local or aberrated:  # steps that act on the shadow itself need it in real space
        shade = sf.ifft2(g, overwrite_x=True)
        if local:
            fade = taper(x, half + fringe, box - fringe)
            shade *= fade[:, None]
            shade *= fade
        if aberrated:
            _aberrate(shade, scene, x / to_shadow)
        g = sf.fft2(shade, overwrite_x=True)
    chirp = np.exp(-1j * np.pi * lam * a * f * f) if scene.main_diffraction else np.ones(n)
    g *= (level / (dx * dx) * chirp)[:, None]
    g *= chirp
    return g, True


def _disc_spectrum(radius: float, f: NDArray[np.float64]) -> Complex:
    """Return the Fourier transform of a disc's indicator on the grid f x f; each distance is computed once."""
    distances, places = folded(f)
    quarter = np.empty((distances.size, distances.size))
    for rows in np.array_split(np.arange(distances.size), 1 + quarter.size // PART):
        quarter[rows] = disc_transform(radius, np.hypot(distances, distances[rows, None]))
    found = np.empty((f.size, f.size), np.complex128)
    for row, place in zip(found, places, strict=True):
        row[:] = quarter[place, places]
    return found


def _aberrate(pupil: Complex, scene: Scene, u: NDArray[np.float64]) -> None:
    """Multiply the pupil on the grid u x u by the phase of its aberration, in parts to save memory."""
    if not scene.wavefront and not scene.exact_defocus:
        return
    if all(m == 0 for _, m, _ in scene.wavefront):  # even along both axes
        distances, places = folded(u)
        turns = np.empty((distances.size, distances.size), np.complex128)
        for rows in np.array_split(np.arange(distances.size), 1 + turns.size // PART):
            turns[rows] = _turns(scene, distances, distances[rows])
        for row, place in zip(pupil, places, strict=True):
            row *= turns[place, places]
        return
    for rows in np.array_split(np.arange(u.size), 1 + u.size * u.size // PART):
        pupil[rows[0] : rows[-1] + 1] *= _turns(scene, u, u[rows])


def _turns(scene: Scene, ux: NDArray[np.float64], uy: NDArray[np.float64]) -> Complex:
    """Return the factor of the pupil due to aberration, and to the lens law at exact angles, on the grid uy x ux."""
    waves = wavefront_waves(scene, ux[None, :], uy[:, None])
    assert waves is not None
    found: Complex = np.exp(2j * np.pi * waves)
    if scene.lens_law:
        found *= pupil_amplitude(scene, ux[None, :] ** 2 + uy[:, None] ** 2)
    return found


def _near_field(scene: Scene, dx: float, half: float, outline: Points) -> tuple[Complex, bool]:
    """Return the field in U-mode.

    The in-focus field, known in closed form and tapered at large distances, is transformed to the pupil and defocused.
    """
    a, lam, fc = scene.reduced_image_um, scene.wavelength_um, 1 / (2 * scene.wavelength_um * scene.rim_f_number)
    limit = 0.98 / (2 * fc * float(np.abs(outline).max()))
    if dx > limit:
        raise InputError.expected(
            "distance of the samples near the native image plane",
            f"at most {limit:.3g} µm",
            f"{dx:.3g} µm",
            "increase the number of samples per pixel",
        )
    if scene.iris.circular and all(m == 0 for _, m, _ in scene.wavefront):
        return _round_near_field(scene, dx, half), False
    blur = abs(a) / (2 * scene.rim_f_number)
    valid = half + blur + 4 * math.sqrt(lam * abs(a))
    n = _side(2 * valid / 0.75, dx)  # the outer quarter is for the taper
    x = (np.arange(n, dtype=np.float64) - n // 2) * dx
    focus = spectrum(fc * outline, x, x)  # light of pupil point u goes to f = -u fc; reversing both signs is the same
    distances, places = folded(x)
    fade = taper(np.hypot(distances, distances[:, None]), 0.75 * (n // 2) * dx, n // 2 * dx)
    for row, place in zip(focus, places, strict=True):
        row *= fade[place, places]
    pupil = sf.fft2(focus, overwrite_x=True)
    f = sf.fftfreq(n, dx)
    chirp = np.exp(1j * np.pi * lam * a * f * f)
    pupil *= (chirp / (math.sqrt(math.pi) * fc))[:, None]
    pupil *= chirp
    _aberrate(pupil, scene, -f / fc)
    return pupil, True


def _round_near_field(scene: Scene, dx: float, half: float) -> Complex:
    """Return the field of a round pupil in U-mode, from its radial integral, which is exact at any distance."""
    lam, nw = scene.wavelength_um, scene.rim_f_number
    u = -2 * math.pi * scene.reduced_image_um / (4 * nw**2 * lam)

    def waves(rho: NDArray[np.float64]) -> NDArray[np.float64]:
        found = wavefront_waves(scene, rho, np.zeros(1))
        return np.zeros_like(rho) if found is None else found

    step = lam * nw / 8
    count = math.ceil((half + 4 * dx) * math.sqrt(2) / step) + 8
    v = np.pi / (lam * nw) * step * np.arange(count, dtype=np.float64)
    steep = sum(2 * math.pi * abs(w) * n * n for n, _, w in scene.wavefront)
    nodes = int((abs(u) / 2 + float(v[-1]) + steep) / 2) + 40
    level = math.sqrt(math.pi) / (2 * lam * nw)

    def amplitude(rho: NDArray[np.float64]) -> NDArray[np.float64]:
        return pupil_amplitude(scene, rho * rho)

    field = focus_integral(u, v, waves, nodes, amplitude if scene.lens_law else None)
    return _turned(parity_spline(level * field, step), dx, half)


def _debye(scene: Scene, dx: float, half: float, mode: str) -> Complex:
    """Return the field in D-mode: the microscope's radial field on the grid, or a field of its dipoles."""
    if scene.vectorial != (mode in DIPOLE_MODES):
        fitting = any_of(DIPOLE_MODES) if scene.vectorial else "D"
        raise InputError.expected("mode of the microscope's field", fitting, mode, "obtain the engine from engine_for")
    field = DIPOLE_MODES[mode] if scene.vectorial else DIPOLE_FIELDS[0]
    values = _turned(radial_field(scene, (half + 8 * dx) * math.sqrt(2), field.order), dx, half)
    if field.order:
        x = np.arange(len(values), dtype=np.float64) - len(values) // 2
        values *= field.angular(x[None, :], x[:, None])
    return values


def _turned(field: Radial, dx: float, half: float) -> Complex:
    """Return a radial field on the grid."""
    n = _side(2 * half, dx)
    x = dx * np.arange(n // 2 + 1, dtype=np.float64)
    quarter = field(np.hypot(x[None, :], x[:, None]))
    index = np.abs(np.arange(n) - n // 2)
    found: Complex = quarter[np.ix_(index, index)]
    return found
