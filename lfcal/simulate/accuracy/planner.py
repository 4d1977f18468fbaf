"""Which effects a scene calls for: those whose estimate exceeds what the tolerance allows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from lfcal.camera import Camera, Microscope, ScanPlan
from lfcal.checks import check_number
from lfcal.errors import InputError
from lfcal.simulate.accuracy.cost import engine_times
from lfcal.simulate.effects import ActsOn, Effect, Estimate, FrameEffect, Outlook, catalogue
from lfcal.simulate.effects.described import SETTINGS
from lfcal.simulate.effects.light import Bandwidth
from lfcal.simulate.staging import light_samples, outlook_of
from lfcal.units import format_seconds

__all__ = ["EffectSelection", "PlannedEffect", "plan_effects"]

FOR_EFFECTS = 0.5
"""Share of the tolerance that the effects left out may take together; the computation takes what they leave of it."""

NOTHING = 1e-5
"""Estimates below this share of the image are as good as none."""


@dataclass(frozen=True, slots=True)
class PlannedEffect:
    """One row of an `EffectSelection`.

    Attributes
    ----------
    effect
        The effect with its magnitudes.
    on
        Whether it is simulated.
    setting
        What the user asked for: ``"auto"``, ``"on"`` or ``"off"``.
    estimate
        Its estimate at the depth where it matters most.
    z_um
        That depth (µm).
    reason
        Why it is on or off, one sentence with numbers and units.
    seconds
        What it adds, or would add, to the time of the whole plan (CPU-seconds on this machine).
    """

    effect: Effect
    on: bool
    setting: str
    estimate: Estimate
    z_um: float
    reason: str
    seconds: float

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name


@dataclass(frozen=True, slots=True)
class EffectSelection:
    """Every effect with on or off, estimate, reason and cost: what `plan_effects` finds.

    Attributes
    ----------
    rows
        In the order of the light's way.
    tolerance
        Relative L1 error allowed for what is left out.
    level
        Level of the engine that the effects call for.
    seconds
        CPU-seconds for the whole plan with everything that is on, predicted within a factor of about 2.
    ideal_seconds
        CPU-seconds of the ideal camera.
    left_out
        Sum of the estimates of the effects that are left out (relative L1), at most half the tolerance.
    """

    rows: tuple[PlannedEffect, ...]
    tolerance: float
    level: str
    seconds: float
    ideal_seconds: float
    left_out: float

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects that are on, ready for `simulate_psf` and `SimulatedCamera`."""
        return tuple(row.effect for row in self.rows if row.on)

    def row(self, name: str) -> PlannedEffect:
        """Return the row of the effect ``name``."""
        for row in self.rows:
            if row.name == name:
                return row
        raise InputError.expected("effect", " or ".join(r.name for r in self.rows), name, "choose one of these")

    def __iter__(self) -> Iterator[Effect]:
        """Iterate over the effects that are on."""
        return iter(self.effects)


def plan_effects(
    camera: Camera,
    region: ScanPlan | Iterable[Outlook],
    tolerance: float = 0.03,
    overrides: Mapping[str, str] | None = None,
    *,
    effects: Sequence[Effect] = (),
    frames: bool = False,
    peak: float = 0.8,
) -> EffectSelection:
    """Return which effects a scene calls for.

    Effects are left out, the costly ones first and then the smallest, as long as their estimates add up to less
    than half the tolerance: the rest is for the computation. Errors of build and use (a gap error, a loose stage) are
    simulated only where they are given in ``effects`` or switched on: their typical size says nothing about this
    camera.

    Parameters
    ----------
    camera
        The camera.
    region
        A scan plan, or the outlooks of its depth planes.
    tolerance
        Relative L1 error of the image allowed, for all that is left out and for the computation together.
    overrides
        Effect name to ``"auto"``, ``"on"`` or ``"off"``.
    effects
        Effects with known magnitudes; each replaces the catalogue's of its name.
    frames
        Whether sensor frames are made: else effects on frames and on the stage's motion are off.
    peak
        Share of the full well that the brightest pixel reaches.

    Raises
    ------
    InputError
        For an unknown name or setting, a tolerance out of range, or a plan of another camera.
    """
    check_number("tolerance", tolerance, above=0, at_most=4, remedy="0.03 is usual")
    planes = _outlooks(camera, region, peak)
    # A given effect takes the place, and the order, of the catalogue's of its name.
    candidates = tuple({e.name: e for e in (*catalogue(), *effects)}.values())
    settings = _settings(overrides or {}, candidates)
    known = {effect.name for effect in effects}
    costs = _Costs(planes, "debye" if isinstance(camera.optics, Microscope) else "wave", tolerance)
    drafts = [_draft(effect, settings[effect.name], planes, costs) for effect in candidates]
    allowed = left = FOR_EFFECTS * tolerance
    rows: dict[str, PlannedEffect] = {}
    # False before True: what costs a fifth of the whole simulation or more comes first, then the smallest errors.
    for draft in sorted(drafts, key=lambda d: (d.seconds < 0.2 * costs.full, d.estimate.error)):
        row = _decide(draft, known=draft.name in known, frames=frames, allowed=allowed, left=left)
        if not row.on and row.setting == "auto" and _counts(row.effect, draft.name in known, frames):
            left -= row.estimate.error
        rows[row.name] = row
    coloured = [row.effect.title for row in rows.values() if row.on and row.effect.by_wavelength]
    width = rows[Bandwidth.name]
    if coloured and width.setting == "auto" and not width.on and width.estimate.size:
        # the wavelengths are there anyway; a width that was given is theirs
        rows[width.name] = replace(width, on=True, reason=f"comes with {' and '.join(coloured)}")
        left += width.estimate.error
    ordered = tuple(rows[e.name] for e in candidates)
    chosen = [row.effect for row in ordered if row.on]
    level = costs.level_of(chosen)
    return EffectSelection(ordered, tolerance, level, costs.total(chosen), costs.rays, allowed - left)


def _outlooks(camera: Camera, region: ScanPlan | Iterable[Outlook], peak: float) -> tuple[Outlook, ...]:
    if isinstance(region, ScanPlan):
        if region.camera != camera:
            raise InputError.expected("camera", f"the plan's ({region.camera.name})", camera.name, "use one camera")
        return tuple(outlook_of(region, z, peak=peak) for z in range(region.shape[0]))
    planes = tuple(region)
    if not planes or any(o.camera != camera for o in planes):
        raise InputError.expected("depth planes", "at least one, of this camera", len(planes), "correct them")
    return planes


def _settings(overrides: Mapping[str, str], candidates: Sequence[Effect]) -> dict[str, str]:
    names = [effect.name for effect in candidates]
    for name, setting in overrides.items():
        if name not in names:
            raise InputError.expected("effect", " or ".join(names), repr(name), "choose one of these")
        if setting not in SETTINGS:
            raise InputError.expected(f"setting of {name}", "auto, on or off", repr(setting), "choose one of these")
    return {name: overrides.get(name, "auto") for name in names}


class _Costs:
    """Predicted CPU-seconds of the whole plan."""

    def __init__(self, planes: Sequence[Outlook], waves: str, tolerance: float) -> None:
        self.waves = waves
        self.planes = [(outlook, engine_times(outlook, waves, tolerance)) for outlook in planes]
        self.rays = sum(engine.rays for _, engine in self.planes)
        self.full = sum(engine.waves for _, engine in self.planes)

    def level_of(self, effects: Iterable[Effect]) -> str:
        """Return the level that the effects call for."""
        return self.waves if any(effect.needs_waves for effect in effects) else "geometric"

    def of(self, effect: Effect) -> float:
        """Return what one effect adds to a wave simulation of one source point."""
        return sum(effect.seconds(outlook, engine) for outlook, engine in self.planes)

    def total(self, effects: Sequence[Effect]) -> float:
        """Return the seconds of all ``effects`` together: source points and wavelengths multiply."""
        by_rays = self.level_of(effects) == "geometric"
        engines = 0.0
        for outlook, engine in self.planes:
            runs = len(light_samples(effects, outlook))
            engines += runs * (engine.rays if by_rays else engine.waves)
        # Waves and further runs are in the engines' seconds already.
        rest = [e for e in effects if not (e.needs_waves or e.by_wavelength or e.acts_on is ActsOn.LIGHT)]
        return engines + sum(self.of(effect) for effect in rest)


def _draft(effect: Effect, setting: str, planes: Sequence[Outlook], costs: _Costs) -> PlannedEffect:
    """Return the row before the decision: the estimate of the worst plane, and the cost."""
    estimate, worst = max(((effect.estimate(o), o) for o in planes), key=lambda pair: pair[0].error)
    return PlannedEffect(effect, False, setting, estimate, worst.z_um, "", costs.of(effect))


def _counts(effect: Effect, known: bool, frames: bool) -> bool:
    """Return whether leaving ``effect`` out is an error of the simulation."""
    return (known or not effect.deviation) and (frames or effect.acts_on.enters_h)


def _decide(draft: PlannedEffect, *, known: bool, frames: bool, allowed: float, left: float) -> PlannedEffect:
    """Return the row with on or off and the reason."""
    effect, e = draft.effect, draft.estimate
    size = f"{e.size:.3g} {e.unit}"
    share = f"{'at most ' if e.upper_bound else ''}{100 * e.error:.2g} % of the image"
    cost = f", {format_seconds(draft.seconds)}" if draft.seconds else ", free"
    if draft.setting == "off":
        return replace(draft, reason=f"switched off: {size}, {share} is missing")
    if not frames and not effect.acts_on.enters_h:
        asked = "asked for, but " if draft.setting == "on" else ""
        return replace(draft, reason=f"{asked}acts on the {effect.acts_on.value}, not on H ({size})")
    if draft.setting == "on":
        if e.size == 0 and effect.deviation and not known:
            return replace(draft, reason=f"asked for, but has no typical size: {size}, give its own")
        return replace(draft, on=True, reason=f"asked for: {size}, {share}{cost}")
    if effect.deviation and not known:
        return replace(draft, reason=f"not known of this camera; a typical {size} would be {share}")
    if isinstance(effect, FrameEffect) and effect.whole_numbers:
        return replace(draft, on=True, reason=f"frames hold whole numbers: {size}, {share}")
    if e.error < NOTHING:
        return replace(draft, reason=f"changes nothing here: {size}")
    within = f"the {100 * allowed:.3g} % that may be left out"
    if e.error > allowed:
        return replace(draft, on=True, reason=f"{size}: {share}, above {within}{cost}")
    if e.error > left:
        taken = 100 * (allowed - left)
        return replace(draft, on=True, reason=f"{size}: {share}, too much beside {taken:.2g} % left out already{cost}")
    return replace(draft, reason=f"{size}: {share}, within {within}")
