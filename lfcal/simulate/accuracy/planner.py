"""Choose the effects that a scene needs: those whose estimate exceeds their share of the tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from lfcal.base import InputError, LfcalError, any_of, check_number, choose, format_seconds, format_share
from lfcal.camera import ScanPlan
from lfcal.simulate._pupil_scene import PupilScene
from lfcal.simulate.accuracy._estimates import estimates_of
from lfcal.simulate.accuracy.cost import Traits, engine_seconds, seconds_within, step_seconds
from lfcal.simulate.effects import (
    SETTINGS,
    ActsOn,
    Bandwidth,
    Effect,
    EngineSeconds,
    Estimate,
    FrameEffect,
    LensletDiffraction,
    Outlook,
    SceneEffect,
    catalogue,
)
from lfcal.simulate.staging import check_applicable, light_samples, outlook_of, scene_for, wave_level

__all__ = ["EffectSelection", "PlannedEffect", "plan_effects"]

EFFECTS_SHARE = 0.5
"""Fraction of the tolerance available to all omitted effects together; the computation may use the rest."""

UNKNOWN = "unknown"
"""Reason of an effect that is off because the camera does not describe it."""

USUAL = 0.03
"""Error of the computation at which effects are compared with the whole computing time."""

NEGLIGIBLE = 1e-5
"""Estimates below this fraction of the image count as zero."""


@dataclass(frozen=True, slots=True)
class PlannedEffect:
    """Decision whether to simulate one effect, a row of an `EffectSelection`.

    Attributes
    ----------
    effect
        The effect with its magnitudes.
    planes
        Whether the effect is simulated, one value for each depth plane.
    setting
        Setting given by the user: ``"auto"``, ``"on"`` or ``"off"``.
    estimate
        Estimate at the depth ``z_um``.
    z_um
        Object depth of the plane where the effect matters most (µm, relative to the working plane, positive away from
        the camera).
    reason
        Reason why the effect is on or off at ``z_um``, as one sentence with numbers and units.
    brief
        The same reason in a few words, for a table column.
    seconds
        Estimated CPU time of the effect alone for all planes on this machine (s).
    seconds_with, seconds_without
        Predicted CPU time for all planes with and without the effect, with the other effects as selected (s).
    errors
        Estimated relative L1 error without the effect, one for each depth plane.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import PlannedEffect, plan_effects
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(4.0),), anchor=(160, 160))
    >>> row: PlannedEffect = plan_effects(plan).row("bandwidth")
    >>> print(row.on, row.brief, row.reason, sep="; ")
    False; small; 0.0364 relative: 0.56 % of the image, within the 1.5 % that may be left out
    """

    effect: Effect
    planes: tuple[bool, ...]
    setting: str
    estimate: Estimate
    z_um: float
    reason: str
    brief: str
    seconds: float
    seconds_with: float = 0.0
    seconds_without: float = 0.0
    errors: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """Name of the effect in plans, files and commands."""
        return self.effect.name

    @property
    def on(self) -> bool:
        """Whether the effect is simulated in at least one plane."""
        return any(self.planes)

    @property
    def undescribed(self) -> bool:
        """Whether the effect is off because the camera does not describe its size."""
        return self.brief == UNKNOWN


@dataclass(frozen=True, slots=True)
class EffectSelection:
    """Effects that apply to a camera, with setting, estimate, reason and cost, as returned by `plan_effects`.

    Attributes
    ----------
    rows
        One row for each effect, in the order of `lfcal.simulate.effects.catalogue`.
    depths_um
        Object depth of each planned plane (µm, relative to the working plane, positive away from the camera).
    tolerance
        Allowed relative L1 error, from omitted effects and computation together.
    level
        Level of the engine that the selected effects require, as in `simulate_psf`.
    seconds
        Predicted CPU time for all planes with the selected effects (s), accurate to within a factor of about 2.
    ideal_seconds
        Predicted CPU time for all planes with the ideal camera (s).
    left_out
        Sum of the estimated relative L1 errors of the effects omitted automatically, one for each plane; at most half
        the tolerance.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import EffectSelection, plan_effects
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(4.0),), anchor=(160, 160))
    >>> found: EffectSelection = plan_effects(plan, overrides={"iris_shape": "off"})
    >>> print(found.level, f"{found.left_out[0]:.2%} left out", found.row("iris_shape").brief, sep="; ")
    wave; 0.56% left out; switched off
    """

    rows: tuple[PlannedEffect, ...]
    depths_um: tuple[float, ...]
    tolerance: float
    level: str
    seconds: float
    ideal_seconds: float
    left_out: tuple[float, ...]

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects that are simulated in at least one plane."""
        return tuple(row.effect for row in self.rows if row.on)

    def plane(self, z_um: float) -> int:
        """Return the index of the planned plane that is nearest to the object depth ``z_um`` (µm)."""
        return min(range(len(self.depths_um)), key=lambda k: abs(self.depths_um[k] - z_um))

    def at(self, z_um: float) -> tuple[Effect, ...]:
        """Return the effects that are simulated in the planned plane nearest to the object depth ``z_um`` (µm)."""
        k = self.plane(z_um)
        return tuple(row.effect for row in self.rows if row.planes[k])

    def row(self, name: str) -> PlannedEffect:
        """Return the row of the effect with the name ``name``; unknown names raise `InputError`."""
        for row in self.rows:
            if row.name == name:
                return row
        names = [row.name for row in self.rows]
        raise InputError.expected("effect", any_of(names), name, choose(name, names))

    def __iter__(self) -> Iterator[Effect]:
        """Iterate over the effects that are simulated in at least one plane."""
        return iter(self.effects)

    def to_dict(self) -> dict[str, Any]:
        """Return level, tolerance, CPU times (s) and effects of the selection as plain JSON types.

        Values for individual planes are not included.
        """
        return {
            "level": self.level,
            "tolerance": self.tolerance,
            "seconds": self.seconds,
            "ideal_seconds": self.ideal_seconds,
            "effects": [
                {
                    "name": row.name,
                    "on": row.on,
                    "setting": row.setting,
                    "size": row.estimate.size,
                    "unit": row.estimate.unit,
                    "error": row.estimate.error,
                    "formula": row.estimate.formula,
                    "z_um": row.z_um,
                    "seconds": row.seconds,
                    "seconds_with": row.seconds_with,
                    "seconds_without": row.seconds_without,
                    "reason": row.reason,
                }
                for row in self.rows
            ],
        }


def plan_effects(
    plan: ScanPlan,
    tolerance: float = 0.03,
    overrides: Mapping[str, str] | None = None,
    *,
    effects: Sequence[Effect] = (),
    frames: bool = False,
    peak: float = 0.8,
) -> EffectSelection:
    """Select the effects to simulate in the planes of a scan, and return them as an `EffectSelection`.

    Effects are left out as long as their estimates add up to at most half of the tolerance. Effects that take a fifth
    of the computing time or more are left out first, then the others, both in the order of increasing error. The other
    half of the tolerance is reserved for errors of the computation. If leaving out fewer effects allows a coarser
    sampling that takes less time in total, fewer are left out. The time therefore never increases with the tolerance.
    Errors of assembly and use (a gap error, a loose stage) are simulated only if they are given in ``effects`` or
    switched on. Their typical sizes may not apply to this camera.

    Parameters
    ----------
    plan
        The camera and its depth planes.
    tolerance
        Allowed relative L1 error of the image, from omitted effects and computation together.
    overrides
        Mapping from names of effects to the settings ``"auto"``, ``"on"`` or ``"off"``; other effects are ``"auto"``.
        None: all effects are ``"auto"``.
    effects
        Effects with known magnitudes, each of which replaces the effect of the same name in `catalogue`.
    frames
        Whether sensor frames are simulated; otherwise, effects on frames and on the motion of the stage are off.
    peak
        Fraction of the full well that the brightest pixel of the session reaches.

    Raises
    ------
    InputError
        If a name or setting is unknown, or the tolerance is out of range.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import plan_effects
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(4.0),), anchor=(160, 160))
    >>> found = plan_effects(plan, tolerance=0.03)
    >>> [effect.name for effect in found], found.level
    (['lens_types', 'lenslet_diffraction', 'iris_diffraction', 'iris_shape', 'telecentricity', 'exact_angles'],
    'wave')
    """
    check_number("tolerance", tolerance, above=0, at_most=4, remedy="0.03 is usual")
    planes = tuple(outlook_of(plan, z, peak=peak) for z in range(plan.shape[0]))
    # a given effect replaces that of the same name in the catalogue, in its order
    candidates = tuple({e.name: e for e in (*catalogue(), *effects)}.values())
    settings = _settings(overrides or {}, candidates)
    check_applicable(plan.camera, (*effects, *(e for e in candidates if (overrides or {}).get(e.name) == "on")))
    candidates = tuple(e for e in candidates if e.applies_to(plan.camera))
    known = {effect.name for effect in effects}
    costs = _Costs(plan, planes, tolerance)
    counting = tuple(e for e in candidates if _counts(e, e.name in known, frames))
    estimates = estimates_of(candidates, counting, planes, plan)
    drafts = [
        _Draft(e, settings[e.name], tuple(found), costs.of(e), known=e.name in known, frames=frames)
        for e, found in zip(candidates, estimates, strict=True)
    ]
    slow = costs.slow(candidates)
    # False before True: first effects that take a fifth of the computing time or more, then the smallest errors
    decided = [
        _fastest(sorted(drafts, key=lambda d: (d.effect.name not in slow, d.at(k).error)), k, costs)
        for k in range(len(planes))
    ]
    rows = tuple(_row(draft, planes, [one.found for one in decided]) for draft in drafts)
    level = costs.level_of(row.effect for row in rows if row.on)
    depths = tuple(outlook.z_um for outlook in planes)
    chosen = tuple(one.effects for one in decided)
    left_out = tuple(one.left_out for one in decided)
    rows = tuple(costs.compared(row, chosen, left_out, frames=frames) for row in rows)
    seconds = sum(one.seconds for one in decided)
    return EffectSelection(rows, depths, tolerance, level, seconds, costs.rays, left_out)


def _settings(overrides: Mapping[str, str], candidates: Sequence[Effect]) -> dict[str, str]:
    names = [effect.name for effect in candidates]
    for name, setting in overrides.items():
        if name not in names:
            raise InputError.expected("effect", any_of(names), repr(name), choose(name, names))
        if setting not in SETTINGS:
            raise InputError.expected(f"setting of {name}", "auto, on or off", repr(setting), "choose one of these")
    return {name: overrides.get(name, "auto") for name in names}


class _Costs:
    """Predicted CPU-seconds of the whole plan."""

    def __init__(self, plan: ScanPlan, planes: Sequence[Outlook], tolerance: float) -> None:
        self.outlooks, self.waves, self.tolerance = planes, wave_level(plan.camera), tolerance
        self._plan = plan
        self._steps: dict[tuple[int, Traits | None], tuple[tuple[float, float], ...]] = {}
        self._rays = [engine_seconds(one, "geometric") for one in planes]
        self._traits: dict[tuple[str, ...], Traits | None] = {}
        self.rays = sum(self._rays)

    def times(self, plane: int, share: float, effects: Iterable[Effect] = ()) -> EngineSeconds:
        """Return the engines' times for a plane with some effects if the computation may have the error ``share``."""
        rays = self._rays[plane]
        key = plane, self._traits_of(e for e in effects if _changes_work(e))
        if key[1] is None:  # single lenslets
            return EngineSeconds(rays, engine_seconds(self.outlooks[plane], self.waves, share))
        if key not in self._steps:
            self._steps[key] = step_seconds(self.outlooks[plane], self.waves, key[1])
        return EngineSeconds(rays, seconds_within(self._steps[key], share))

    def _traits_of(self, effects: Iterable[Effect]) -> Traits | None:
        """Return the traits of the scene with some effects; None for a Fourier light-field microscope."""
        chosen = tuple(effects)
        names = tuple(effect.name for effect in chosen)
        if names not in self._traits:
            try:
                scene = scene_for(self._plan, 0, chosen)
            except LfcalError:  # for example, a typical cover glass thicker than the gap
                if not chosen:
                    raise
                return self._traits_of(chosen[:-1])
            self._traits[names] = None if isinstance(scene, PupilScene) else Traits.of(scene)
        return self._traits[names]

    def level_of(self, effects: Iterable[Effect]) -> str:
        """Return the level that the effects need; for a Fourier light-field microscope, always that of waves."""
        waves = not self.outlooks[0].camera.has_lattice
        return self.waves if waves or any(effect.needs_waves for effect in effects) else "geometric"

    def of(self, effect: Effect, share: float | None = None) -> float:
        """Return the time that one effect adds to a wave simulation of one source point, at the error ``share``."""
        error, planes = self.tolerance if share is None else share, range(len(self.outlooks))
        if _changes_work(effect):
            added = (self.times(k, error, (effect,)).waves - self.times(k, error).waves for k in planes)
            return max(0.0, sum(added))
        return sum(effect.seconds(self.outlooks[k], self.times(k, error)) for k in planes)

    def slow(self, effects: Iterable[Effect]) -> set[str]:
        """Return the names of the effects that take a fifth of the computing time or more.

        They are the same for all tolerances, so that the order in which effects are left out is too.
        """
        whole = sum(self.times(k, USUAL).waves for k in range(len(self.outlooks)))
        return {effect.name for effect in effects if self.of(effect, USUAL) >= 0.2 * whole}

    def of_plane(self, plane: int, effects: Sequence[Effect], share: float) -> float:
        """Return the seconds of a plane with some effects, for all source points and wavelengths."""
        outlook, engine = self.outlooks[plane], self.times(plane, share, effects)
        by_rays = self.level_of(effects) == "geometric"
        runs = len(light_samples(effects, outlook))
        # the step from rays to waves, further runs, and changes of the scene are included in the seconds of the engines
        others = sum(e.seconds(outlook, engine) for e in effects if not (_in_engines(e) or _changes_work(e)))
        return runs * (engine.rays if by_rays else engine.waves) + others

    def compared(
        self, row: PlannedEffect, chosen: Sequence[Sequence[Effect]], left_out: Sequence[float], *, frames: bool
    ) -> PlannedEffect:
        """Return the row with the seconds for the effects chosen in each plane, with and without the row's effect.

        An effect that is off is added to every plane, unless it acts only on ``frames`` that are not simulated. The
        sampling remains as it is.
        """
        planes = row.planes if row.on else (frames or row.effect.acts_on.enters_h,) * len(chosen)
        others = [[e for e in effects if e.name != row.name] for effects in chosen]
        complete = [[*some, row.effect] if on else some for some, on in zip(others, planes, strict=True)]

        def total(effects: Sequence[Sequence[Effect]]) -> float:
            return sum(self.of_plane(k, effects[k], self.tolerance - out) for k, out in enumerate(left_out))

        return replace(row, seconds_with=total(complete), seconds_without=total(others))


def _changes_work(effect: Effect) -> bool:
    return isinstance(effect, SceneEffect) and effect.changes_work


def _in_engines(effect: Effect) -> bool:
    """Return whether an effect's seconds are those of engines: for the step from rays to waves, or for further runs."""
    return isinstance(effect, LensletDiffraction) or effect.by_wavelength or effect.acts_on is ActsOn.LIGHT


@dataclass(frozen=True, slots=True)
class _Draft:
    """An effect before the decision: its estimate at every plane, and the cost of all planes."""

    effect: Effect
    setting: str
    estimates: tuple[Estimate, ...]
    seconds: float
    known: bool
    frames: bool

    def at(self, plane: int) -> Estimate:
        """Return the estimate that decides at a plane; for effects on frames, it is the largest of all planes."""
        return self.estimates[plane] if self.effect.acts_on.enters_h else max(self.estimates, key=lambda e: e.error)


def _counts(effect: Effect, known: bool, frames: bool) -> bool:
    """Return whether leaving ``effect`` out is an error of the simulation."""
    return (known or not effect.deviation) and (frames or effect.acts_on.enters_h)


class _Decided(NamedTuple):
    """Decisions at one plane by the name of the effect, with the omitted error and the plane's CPU-seconds.

    The error ``used`` includes the error of a bandwidth that other effects need, which is not left out.
    """

    found: dict[str, _Decision]
    effects: tuple[Effect, ...]
    used: float
    left_out: float
    seconds: float


def _fastest(drafts: Sequence[_Draft], plane: int, costs: _Costs) -> _Decided:
    """Return the decisions at one plane with which it takes the least time.

    What omitted effects leave of the tolerance may require a sampling that costs more time than the effects do. All
    decisions of smaller tolerances are among those tried, so that the time never increases with the tolerance.
    """
    best = tried = _decided(drafts, plane, EFFECTS_SHARE * costs.tolerance, costs)
    used = math.inf
    while 0 < tried.used < used:  # it no longer falls if only negligible effects are left out
        used = tried.used
        # between this limit and the error in use, the decisions do not change
        tried = _decided(drafts, plane, math.nextafter(used, 0.0), costs)
        if tried.seconds < best.seconds:
            best = tried
    return best


def _decided(drafts: Sequence[_Draft], plane: int, allowed: float, costs: _Costs) -> _Decided:
    """Return on or off with the reason for each effect at one plane."""
    found: dict[str, _Decision] = {}
    used = 0.0
    for draft in drafts:
        decided = _decide(draft, draft.at(plane), allowed, used)
        if not decided.on and draft.setting == "auto" and _counts(draft.effect, draft.known, draft.frames):
            used += draft.at(plane).error
        found[draft.effect.name] = decided
    left_out = used - _with_bandwidth(drafts, plane, found)
    chosen = tuple(draft.effect for draft in drafts if found[draft.effect.name].on)
    return _Decided(found, chosen, used, left_out, costs.of_plane(plane, chosen, costs.tolerance - left_out))


def _with_bandwidth(drafts: Sequence[_Draft], plane: int, found: dict[str, _Decision]) -> float:
    """Switch the bandwidth on if another effect spreads the wavelengths; return the error that this avoids."""
    coloured = [d.effect.title for d in drafts if found[d.effect.name].on and d.effect.by_wavelength]
    width = next(d for d in drafts if d.effect.name == Bandwidth.name)
    if not coloured or width.setting != "auto" or found[Bandwidth.name].on or not width.at(plane).size:
        return 0.0
    found[Bandwidth.name] = _Decision(True, "needed by others", f"needed by {' and '.join(coloured)}")
    return width.at(plane).error


def _row(draft: _Draft, planes: Sequence[Outlook], decided: Sequence[Mapping[str, _Decision]]) -> PlannedEffect:
    """Return the row of an effect; its reason is that of the plane where the effect matters most."""
    on = tuple(found[draft.effect.name].on for found in decided)
    # among the planes where it is on, if any: a slightly larger estimate elsewhere may have been within the tolerance
    worst = max(range(len(planes)), key=lambda k: (on[k], draft.at(k).error))
    _, brief, reason = decided[worst][draft.effect.name]
    if any(on) and not all(on):
        brief = f"{sum(on)} of {len(on)} planes"
        reason += f"; on at {brief}"
    estimate, z_um = draft.at(worst), planes[worst].z_um
    errors = tuple(draft.at(k).error for k in range(len(planes)))
    return PlannedEffect(draft.effect, on, draft.setting, estimate, z_um, reason, brief, draft.seconds, errors=errors)


class _Decision(NamedTuple):
    """Whether an effect is on at a plane, and why: in a word or two, and in a sentence."""

    on: bool
    brief: str
    reason: str


def _decide(draft: _Draft, e: Estimate, allowed: float, used: float) -> _Decision:
    """Return on or off with the reason; ``used`` is the error of the effects that are already left out."""
    effect = draft.effect
    size = f"{e.size:.3g} {e.unit}"
    share = f"{'at most ' if e.upper_bound else ''}{format_share(e.error)} of the image"
    cost = f", {format_seconds(draft.seconds)}" if draft.seconds else ", free"
    if draft.setting == "off":
        return _Decision(False, "switched off", f"switched off: {size}; {share} is missing")
    if not draft.frames and not effect.acts_on.enters_h:
        asked = "switched on, but " if draft.setting == "on" else ""
        return _Decision(False, "not in H", f"{asked}acts on the {effect.acts_on.value}, not on H ({size})")
    if draft.setting == "on":
        if e.size == 0 and effect.deviation and not draft.known:
            return _Decision(False, "needs a size", f"switched on, but has no typical size ({size}); give a size")
        return _Decision(True, "switched on", f"switched on: {size}, {share}{cost}")
    if effect.deviation and not draft.known:
        return _Decision(False, UNKNOWN, f"unknown for this camera; a typical {size} would be {share}")
    if isinstance(effect, FrameEffect) and effect.whole_numbers:
        return _Decision(True, "always", f"frames consist of whole numbers: {size}, {share}")
    if e.error < NEGLIGIBLE:
        return _Decision(False, "no effect", f"negligible here: {size}")
    within = f"the {100 * allowed:.3g} % that may be left out"
    if e.error > allowed:
        return _Decision(True, "needed", f"{size}: {share}, above {within}{cost}")
    if used + e.error > allowed:  # the sum as `_decided` adds it: a difference may be rounded otherwise
        return _Decision(
            True, "needed", f"{size}: {share}, too much, because {format_share(used)} is already left out{cost}"
        )
    return _Decision(False, "small", f"{size}: {share}, within {within}")
