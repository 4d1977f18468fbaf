"""Elemental images of a Fourier light-field microscope: their positions, their light, and the start of a fit.

Light is only in small parts of a cutout, the elemental images of the point, one behind each lenslet. With the position
c of a lenslet from the optical axis at o, the image of a point at depth z is at

    p(z) = o + c (1 + s(z)) + m t z,        s(z) = -z B M² / (n f²),

with the gap B, the focal length f of the Fourier lens and the tilt t of the source's travel; m is the magnification
[1]_. Straight lines through the centroids of each image therefore determine the position of each lenslet, the ratio
M/f, and the tilt. From this start, a fit of the pixels by wave optics converges.

References
----------
.. [1] C. Guo et al., "Fourier light-field microscopy", Opt. Express 27, 25573 (2019), section 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, centre
from lfcal.camera import Camera, Microscope, PupilLenslets
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness
from lfcal.fit.setup import Setup
from lfcal.simulate import PlaneResponse, PupilScene, Sampling, at_wavelength, filtered
from lfcal.simulate.engines import PupilPlane

__all__ = ["Elemental", "elemental_of"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

NODES = {Fineness.coarse: 2, Fineness.fine: 3, Fineness.finest: 3}
"""Nodes per pixel along each axis, for spots of about two pixels."""

AIRY = 8.0
"""Half width of an elemental image around its geometric spot, in units of lambda B/d; 2 % of its light is outside."""

SPARE_PX = 3
"""Margin on every side for the errors of the centroids (pixels)."""

ABOVE = 5.0
"""Standard deviations of dark pixels above which a pixel is lit."""

REACH = 0.45
"""Radius in which an elemental image is searched for, as a fraction of the distance between elemental images."""

LOST = 0.2
"""Fraction of the lit pixels of an elemental image that may be invalid, for example saturated."""

CLIPPED = 0.9
"""Fraction of the brightest valid value of a pattern above which an invalid pixel counts as saturated."""

INVALID = (
    "shorten the exposure, because pixels of these images are saturated",
    "record these planes again, because pixels of these images are NaN or infinite",
    "correct the mask of defective pixels, or use a cutout inside the frame, because pixels of these images are masked",
)
"""Remedy if too many pixels of an elemental image are invalid, by reason."""

MOVED_PX = 2.0
"""Smallest displacement of the elemental images between the outermost planes that shows the parallax (pixels)."""

FEWEST = 3
"""Smallest number of planes."""

KEPT = 4096
"""Number of elemental images kept in memory, of some thousand pixels each."""

LightIn = Callable[[PupilScene, tuple[int, int, int, int], tuple[float, float], int], F4]


def _light_in(scene: PupilScene, box: tuple[int, int, int, int], chief: tuple[float, float], nodes: int) -> F4:
    engine = PupilPlane(scene, "wave", Sampling(nodes_per_px=nodes))
    return engine.light_in((slice(box[0], box[1]), slice(box[2], box[3])), chief)


@dataclass(frozen=True, slots=True)
class _Image:
    """A box of the cutout ``(top, bottom, left, right)``, and the lenslets whose light it contains."""

    box: tuple[int, int, int, int]
    lenslets: tuple[int, ...]

    @property
    def size(self) -> int:
        return (self.box[1] - self.box[0]) * (self.box[3] - self.box[2])

    def overlaps(self, other: _Image) -> bool:
        (a, b, c, d), (e, f, g, h) = self.box, other.box
        return a < f and e < b and c < h and g < d

    def joined(self, other: _Image) -> _Image:
        (a, b, c, d), (e, f, g, h) = self.box, other.box
        return _Image((min(a, e), max(b, f), min(c, g), max(d, h)), (*self.lenslets, *other.lenslets))


@dataclass(frozen=True, eq=False)
class Elemental(Measured):
    """Patterns of which only the pixels of the elemental images are used, as samples ``(n, m)``.

    Attributes
    ----------
    pixels
        Index of each sample in the flattened cutout ``(n, m)``.
    boxes
        The elemental images of each pattern, in the order of its samples.
    light_in
        Function that returns the light of a scene in one elemental image. Results are cached, because a change of one
        lenslet changes only one image.
    """

    pixels: NDArray[np.intp] = field(default_factory=lambda: np.zeros((0, 0), np.intp))
    boxes: tuple[tuple[_Image, ...], ...] = ()
    light_in: LightIn = _light_in

    @property
    def sampled(self) -> tuple[int, ...]:
        """Shape ``(m,)`` of the samples of a pattern."""
        return (self.pixels.shape[1],)

    def images(self, samples: F4) -> F4:
        """Return the samples ``(n, m)`` of patterns as images of the cutout ``(n, nt, ns)``; 0 outside the samples."""
        out = np.zeros((len(samples), math.prod(self.plan.cutout)), np.float32)
        # samples beyond the last image repeat a pixel and are not valid
        for k, (own, good) in enumerate(zip(samples, self.valid, strict=True)):
            out[k, self.pixels[k, good]] = own[good]
        return out.reshape(-1, *self.plan.cutout)

    def of(self, keep: NDArray[np.bool_]) -> Elemental:
        """Return the patterns that the mask ``keep`` ``(n,)`` selects."""
        boxes = tuple(one for one, own in zip(self.boxes, keep, strict=True) if own)
        return replace(self, **self._some(keep), pixels=self.pixels[keep], boxes=boxes)

    def predicted(self, setup: Setup, offsets_px: F8, sampling: Sampling) -> F4:
        """Return the light ``(n, m)`` of a setup in the samples; ``offsets_px`` ``(n, 2)`` displaces the sources."""
        out = np.zeros((len(self), *self.sampled), np.float32)
        plan = setup.plan(self.plan)
        for z in np.unique(self.index[:, 0]).tolist():
            further = setup.depth_errors_um[z]
            response = PlaneResponse(plan, z, setup.effects, level="wave", sampling=sampling, depth_error_um=further)
            assert isinstance(response.scene, PupilScene)
            for k in np.flatnonzero(self.index[:, 0] == z).tolist():
                moved = offsets_px[k] + np.array(setup.aside_px) + setup.drift_px(plan.depths_um[z])
                out[k, : sum(one.size for one in self.boxes[k])] = np.concatenate(
                    [self._one(response, one, moved, NODES.get(sampling, 3)).ravel() for one in self.boxes[k]]
                )
        return out

    def _one(self, response: PlaneResponse, image: _Image, moved_px: F8, nodes: int) -> F4:
        """Return the light in one box from all of its lenslets, source points and wavelengths."""
        scene: Any = response.scene
        lenslets, halo, (top, bottom, left, right) = scene.lenslets, response.halo, image.box
        some = replace(
            lenslets,
            lens_centres_um=tuple(lenslets.lens_centres_um[k] for k in image.lenslets),
            focal_lengths_um=tuple(float(lenslets.focal_um[k]) for k in image.lenslets),
        )
        # the cutout of the response is wider by the halo of its filter
        box = (top, bottom + 2 * halo, left, right + 2 * halo)
        total = np.zeros((box[1] - box[0], box[3] - box[2]), np.float32)
        planned = np.zeros(2) if scene.offsets_um is None else scene.offsets_um[0, 0]
        for sample in response.samples:
            y, x = (planned + (moved_px + np.array([sample.rows, sample.columns])) * scene.pixel_um).tolist()
            own: Any = replace(at_wavelength(scene, sample.wavelength_um), lenslets=some, offsets_um=None)
            total += np.float32(sample.weight) * self.light_in(own, box, (y, x), nodes)
        if response.kernel is None:
            return total
        return filtered(total, response.kernel)[halo:-halo, halo:-halo]


@dataclass(frozen=True, eq=False)
class _Lines:
    """Straight lines through the elemental images: positions at z = 0 and slopes, each ``(k, 2)``.

    Positions are rows and columns of the cutout (pixels). Slopes are in pixels per µm.
    """

    places: F8
    slopes: F8

    def at(self, z_um: float) -> F8:
        return self.places + z_um * self.slopes


def elemental_of(measured: Measured) -> tuple[Elemental, dict[str, float]]:
    """Return the elemental images of patterns, and the differences of unknowns from the description, by name.

    Raises
    ------
    InputError
        If the planes are too few or too close to each other, or the images of a lenslet are not found.
    """
    _check_planes(measured)
    lines = _lines(measured, *_centroids(measured))
    changes = _changes(measured, lines)
    boxes = tuple(_boxes(measured, lines, z) for z in measured.index[:, 0].tolist())
    ns, m = measured.plan.cutout[1], max(sum(image.size for image in own) for own in boxes)
    pixels, valid = np.zeros((len(measured), m), np.intp), np.zeros((len(measured), m), np.bool_)
    for k, own in enumerate(boxes):
        at = np.concatenate(
            [(np.arange(a, b)[:, None] * ns + np.arange(c, d)).ravel() for a, b, c, d in (one.box for one in own)]
        )
        pixels[k, : at.size], valid[k, : at.size] = at, measured.valid[k].ravel()[at]
    patterns = np.take_along_axis(measured.patterns.reshape(len(measured), -1), pixels, 1)
    found = Elemental(
        measured.plan,
        measured.index,
        patterns,
        measured.noise,
        measured.places_px,
        valid,
        measured.held_out,
        pixels=pixels,
        boxes=boxes,
        light_in=lru_cache(maxsize=KEPT)(_light_in),
    )
    return found, changes


def _check_planes(measured: Measured) -> None:
    depths = {measured.plan.depths_um[z] for z in measured.index[:, 0].tolist()}
    if len(depths) < FEWEST:
        wanted = f"at least {FEWEST} planes in the z stack of a point"
        raise InputError.expected(
            "planes of a Fourier light-field microscope", wanted, len(depths), "record more planes"
        )


def _lenslets(camera: Camera) -> tuple[PupilLenslets, Microscope]:
    assert isinstance(camera.lattice, PupilLenslets) and isinstance(camera.optics, Microscope)
    return camera.lattice, camera.optics


def _source_px(measured: Measured) -> F8:
    """Return the point (row, column) of the cutout that the chief ray of the source meets."""
    plan = measured.plan
    anchor = np.array(plan.anchor)
    found: F8 = np.array([centre(n) for n in plan.cutout]) + anchor - np.floor(anchor + 0.5)
    return found


def _described(measured: Measured) -> _Lines:
    """Return the lines of the described camera."""
    lattice, optics = _lenslets(measured.plan.camera)
    px = measured.plan.camera.sensor.pixel_um
    centres = np.array(lattice.lens_centres_um)[:, ::-1]
    # the slope of the wave at a lenslet's centre, by the sine condition
    rate = optics.magnification / (optics.medium_index * lattice.fourier_um)
    cosine = np.sqrt(1 - np.minimum(np.square(centres).sum(1) * rate**2, 0.9))
    bend = -lattice.gap_um * optics.medium_index * rate**2 / cosine
    return _Lines(_source_px(measured) + centres / px, bend[:, None] * centres / px)


def _airy_px(camera: Camera) -> float:
    lattice, _ = _lenslets(camera)
    return camera.wavelength_um * lattice.gap_um / lattice.clear_um / camera.sensor.pixel_um


def _half_px(camera: Camera, z_um: float) -> int:
    """Return the half width of the elemental images of a plane (pixels)."""
    lattice, optics = _lenslets(camera)
    bend = float(np.abs(1 - lattice.gap_um / lattice.focal_um).max()) + abs(lattice.spread(optics, z_um))
    return math.ceil(lattice.clear_um / 2 * bend / camera.sensor.pixel_um + AIRY * _airy_px(camera)) + SPARE_PX


def _centroids(measured: Measured) -> tuple[F8, NDArray[np.bool_]]:
    """Return the centroid (row, column) of every elemental image ``(n, k, 2)``, and a mask of those that were found."""
    plan, camera = measured.plan, measured.plan.camera
    lines, spacing = _described(measured), _lenslets(camera)[0].spacing_um / camera.sensor.pixel_um
    depths = [plan.depths_um[z] for z in measured.index[:, 0].tolist()]
    expected = np.stack([lines.at(z) for z in depths])
    found, seen = np.full(expected.shape, np.nan), np.zeros(expected.shape[:2], np.bool_)
    lit = [_lit(measured, k) for k in range(len(measured))]
    shift = np.zeros(2)
    # the whole array may be displaced: its common displacement first, then each image
    for turn in range(2):
        for k, z in enumerate(depths):
            reach = min(REACH * spacing, max(plan.cutout))
            for j, place in enumerate(expected[k] + shift):
                found[k, j], seen[k, j] = _centroid(lit[k], measured.valid[k], place, [reach, _half_px(camera, z)])
        if not seen.any():
            break
        if turn == 0:
            shift = np.median((found - expected)[seen], axis=0)
    _check_seen(measured, found, seen)
    return found, seen


def _lit(measured: Measured, k: int) -> F8:
    """Return the light of a pattern above its background; 0 in dark pixels."""
    pattern, good = measured.patterns[k].astype(np.float64), measured.valid[k]
    level = float(np.median(pattern[good])) if good.any() else 0.0
    light = np.where(good, pattern - level, 0.0)
    noise = max(math.sqrt(measured.noise[k, 0]), 1.4826 * float(np.median(np.abs(light))))
    # saturated pixels are invalid, and lit
    return np.where(light > ABOVE * noise, light, 0.0)


def _centroid(lit: F8, valid: NDArray[np.bool_], place: F8, reaches: Sequence[float]) -> tuple[F8, bool]:
    """Return the centroid of the light near ``place``, and whether enough of its pixels are valid.

    The light is searched for within successively smaller discs of the radii ``reaches``.
    """
    rows, columns = lit.shape
    for reach in [*reaches, reaches[-1]]:
        top, left = (max(0, math.floor(c - reach)) for c in place)
        bottom, right = (min(n, math.ceil(c + reach) + 1) for n, c in zip((rows, columns), place, strict=True))
        if top >= bottom or left >= right:
            return place, False
        y, x = np.mgrid[top:bottom, left:right]
        inside = np.hypot(y - place[0], x - place[1]) <= reach
        light = np.where(inside, lit[top:bottom, left:right], 0.0)
        total = float(light.sum())
        if total <= 0:
            return place, False
        place = np.array([(light * y).sum(), (light * x).sum()]) / total
    lost = np.count_nonzero(inside & ~valid[top:bottom, left:right])
    return place, bool(lost <= LOST * np.count_nonzero(light > 0))


def _check_seen(measured: Measured, found: F8, seen: NDArray[np.bool_]) -> None:
    """Raise `InputError` with the reason if fewer than two usable images of a lenslet were found."""
    for j, often in enumerate(seen.sum(0).tolist()):
        if often < 2:
            x, y = _lenslets(measured.plan.camera)[0].lens_centres_um[j]
            raise InputError.expected(
                f"elemental images of the lenslet at ({x:g}, {y:g}) µm",
                "a usable image at the described position in at least two planes",
                f"one in {often} of {len(seen)} planes",
                _remedy(measured, found[:, j], ~seen[:, j]),
            )


def _remedy(measured: Measured, places: F8, unseen: NDArray[np.bool_]) -> str:
    """Return the remedy for the ``unseen`` images of a lenslet, which were searched for at ``places`` ``(n, 2)``."""
    counts = np.zeros(3, np.intp)
    for k in np.flatnonzero(unseen).tolist():
        counts += _invalid(measured, k, places[k])
    if not counts.any():
        return (
            "correct the lenslet centres in the description of the camera, or measure them in a white image "
            "(lfcal white)"
        )
    return INVALID[int(np.argmax(counts))]


def _invalid(measured: Measured, k: int, place: F8) -> NDArray[np.intp]:
    """Return the number of invalid pixels of an elemental image by reason, as in `INVALID`; 0 if they are few."""
    pattern, good = measured.patterns[k], measured.valid[k]
    y, x = np.indices(pattern.shape)
    inside = np.hypot(y - place[0], x - place[1]) <= _half_px(
        measured.plan.camera, measured.plan.depths_um[int(measured.index[k, 0])]
    )
    lit = np.count_nonzero(inside & (_lit(measured, k) > 0)) or np.count_nonzero(inside)
    lost = pattern[inside & ~good]
    if lost.size <= LOST * lit:
        return np.zeros(3, np.intp)
    finite = lost[np.isfinite(lost)]
    brightest = float(pattern[good].max(initial=0.0))
    bright = np.count_nonzero((finite > 0) & (finite >= CLIPPED * brightest))
    return np.array([bright, lost.size - finite.size, finite.size - bright], np.intp)


def _lines(measured: Measured, found: F8, seen: NDArray[np.bool_]) -> _Lines:
    """Return the straight line through the centroids of each lenslet."""
    depths = np.array([measured.plan.depths_um[z] for z in measured.index[:, 0].tolist()])
    places, slopes = np.zeros(found.shape[1:]), np.zeros(found.shape[1:])
    for j in range(found.shape[1]):
        own = seen[:, j]
        by = np.stack([np.ones(int(own.sum())), depths[own]], axis=1)
        (places[j], slopes[j]), *_ = np.linalg.lstsq(by, found[own, j], rcond=None)
    return _Lines(places, slopes)


def _changes(measured: Measured, lines: _Lines) -> dict[str, float]:
    """Return the differences of lenslets, Fourier lens and travel from the description, by name of the unknown."""
    camera, described = measured.plan.camera, _described(measured)
    depths = [measured.plan.depths_um[z] for z in measured.index[:, 0].tolist()]
    reach = max(depths) - min(depths)
    if float(np.hypot(*described.slopes.T).max()) * reach < MOVED_PX:
        wanted = f"a range over which elemental images move by {MOVED_PX:g} px or more"
        raise InputError.expected(
            "depths of the patterns",
            wanted,
            f"a range of {reach:g} µm, over which they move less",
            "record planes farther apart",
        )
    # slopes = share * described + tilt of the travel
    k = len(lines.slopes)
    by = np.zeros((2 * k, 3))
    by[:, 0], by[:k, 1], by[k:, 2] = described.slopes.T.ravel(), 1.0, 1.0
    (share, *tilt), *_ = np.linalg.lstsq(by, lines.slopes.T.ravel(), rcond=None)
    if share <= 0:
        raise InputError.expected(
            "sign of the depths",
            "the sign in the plan",
            "the opposite sign in the images",
            "reverse the sign of the depths in the plan",
        )
    lattice, _ = _lenslets(camera)
    moved = (lines.places - described.places)[:, ::-1] * camera.sensor.pixel_um
    changes = {f"lenslet_{j}_x_um": float(v) for j, v in enumerate(moved[:, 0])}
    changes |= {f"lenslet_{j}_y_um": float(v) for j, v in enumerate(moved[:, 1])}
    changes["fourier_um"] = lattice.fourier_um * (share**-0.5 - 1)
    step = camera.step_um()
    return changes | {
        f"travel_{axis}_rad": math.atan(v * step) for axis, v in zip(("rows", "columns"), tilt, strict=True)
    }


def _boxes(measured: Measured, lines: _Lines, z: int) -> tuple[_Image, ...]:
    """Return the elemental images of a plane, with those that overlap merged."""
    depth, (nt, ns) = measured.plan.depths_um[z], measured.plan.cutout
    half, left = _half_px(measured.plan.camera, depth), list[_Image]()
    for j, (row, column) in enumerate(np.rint(lines.at(depth)).astype(int).tolist()):
        box = (max(0, row - half), min(nt, row + half + 1), max(0, column - half), min(ns, column + half + 1))
        if box[0] < box[1] and box[2] < box[3]:
            left.append(_Image(box, (j,)))
    found: list[_Image] = []
    while left:
        one = left.pop()
        others = [image for image in (*left, *found) if one.overlaps(image)]
        if not others:
            found.append(one)
            continue
        # the box of both may overlap images that neither of them did
        left, found = ([image for image in some if image not in others] for some in (left, found))
        for image in others:
            one = one.joined(image)
        left.append(one)
    return tuple(found)
