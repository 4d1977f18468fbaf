"""Recalibrate a camera with frames of unknown objects, and decide whether the result explains them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    Clock,
    InputError,
    Work,
    drained,
    format_bytes,
    format_pixels,
    format_seconds,
    free_memory,
    note,
)
from lfcal.camera import Camera, NoLatticeError, ScanPlan
from lfcal.fit import (
    Fineness,
    NewFrame,
    Parameter,
    ScanScales,
    Setup,
    Vector,
    check_groups,
    lacking,
    starting_effects,
)
from lfcal.recalibrate._forecast import Round, processor_seconds
from lfcal.recalibrate._frames import ROOM, distinct_label, in_window, whole_frame, windows_within
from lfcal.recalibrate._modes import Modes
from lfcal.recalibrate._scene import ObjectFrame
from lfcal.recalibrate._steps import Arrays, Steps
from lfcal.recalibrate._window import SensorWindow
from lfcal.recalibrate.model import COPIES, DEPTH_SCALE, Contents, WindowModel
from lfcal.recalibrate.score import Goodness, Score
from lfcal.simulate.effects import Effect
from lfcal.simulate.engines import EnergyError

__all__ = ["ALARM", "DETERMINED", "Recalibration", "iter_recalibrate", "recalibrate"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

ALARM = 1.05
"""Goodness of fit above which a camera is not recalibrated."""

OVERSTATED = 0.85
"""Goodness of fit below which the noise is overstated, so that the goodness of fit would not show a wrong camera."""

FREEDOM = 2 * (2 / (ALARM - 1)) ** 2
"""Degrees of freedom at which noise alone changes the goodness of fit by half of what is allowed."""

DETERMINED = ("geometry", "pitch", "focal_lengths", "iris", "wavefront")
"""Groups of unknowns that frames of unknown objects determine."""

ROUNDS = (
    (15, Fineness.coarse, 0.9),
    (30, Fineness.coarse, 0.97),
    (60, Fineness.coarse, 0.995),
    (100, Fineness.coarse, 0.0),
    (100, Fineness.fine, 0.0),
)
"""Iterations for the object, sampling, and fraction of the light whose voxels determine derivatives, of each round.

The object is known better from round to round. Derivatives for the many dark voxels would be slow and add little. If
the fraction is 0, earlier derivatives are used. These change the length of a step, not the camera at which the score is
zero.
"""

LONGEST = 8.0
"""Longest step of a round, in scales."""

UNCERTAINTY = 3.0
"""Prior standard deviation of an unknown without a stated one, in scales."""

FLOORS = {"focal_lengths": 2e-3, "iris": 1e-3, "geometry": 2e-4, "pitch": 1e-5}
"""Error of the model by group of unknowns, as a fraction of the described value: stated noise does not include it."""

CLEAR = 2.0
"""Change of an unknown with the scale of the depths, in standard deviations, above which it is reported."""

LEAST_SHARE = 0.2
"""Relative change of an unknown, divided by that of the depths, above which it is reported."""

HELPS = 0.7
"""Excess of the goodness of fit over 1 with a remedy, divided by that without, below which the remedy is named."""


@dataclass(frozen=True)
class Remedy:
    """A possible reason for a poor fit, and the assumptions about the frames that would remedy it.

    Attributes
    ----------
    reason, remedy
        What is likely wrong, and what to assume instead, as text.
    contents
        Assumptions to use instead.
    """

    reason: str
    remedy: str
    contents: Contents


@dataclass(frozen=True, eq=False)
class Recalibration:
    """A camera recalibrated on frames of unknown objects.

    Attributes
    ----------
    setup
        The camera with its effects.
    planned
        Scan plan with the described camera; it states the planes and the cutout of H.
    parameters
        Fitted unknowns by name. Their standard deviations include the error of the model.
    goodness
        Goodness of fit of each frame, by its name, in the window where it is largest.
    contents
        Assumptions about the contents of the frames.
    remedies
        What was changed, or what may be wrong, one sentence each.
    undetermined
        Names of the unknowns in each combination that the frames do not determine; the fit does not change these
        combinations.
    depth_scale
        Change (%) of an unknown, by name, if all depths are 1 % larger; only for unknowns that change clearly. H hardly
        depends on the scale of the depths, which is assumed to be known.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.fit import Setup
    >>> from lfcal.recalibrate import Contents, Goodness, Recalibration
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3], cutout=49)
    >>> setup, contents = Setup(plan.camera, (), (0.0,)), Contents(plan.depths_um)
    >>> found = Recalibration(setup, plan, {}, {"beads.tif": Goodness(1.2, 9000.0)}, contents)
    >>> print(found.accepted, found.verdict, sep="; ")
    False; not recalibrated: the goodness of fit is 1.20, but at most 1.05 is allowed
    """

    setup: Setup
    planned: ScanPlan
    parameters: Mapping[str, Parameter]
    goodness: Mapping[str, Goodness]
    contents: Contents
    remedies: tuple[str, ...] = ()
    undetermined: tuple[tuple[str, ...], ...] = ()
    depth_scale: Mapping[str, float] = field(default_factory=dict)

    @property
    def camera(self) -> Camera:
        """Recalibrated camera."""
        return self.setup.camera

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects of the recalibrated camera."""
        return self.setup.effects

    @property
    def worst(self) -> float:
        """Largest goodness of fit of all frames, that of the poorest fit."""
        return max(one.ratio for one in self.goodness.values())

    @property
    def objections(self) -> tuple[str, ...]:
        """Reasons why the result cannot be trusted, one clause each; empty if there are none."""
        found = []
        if self.worst > ALARM:
            found.append(f"the goodness of fit is {self.worst:.2f}, but at most {ALARM:g} is allowed")
        least = min(self.goodness.values(), key=lambda one: one.ratio)
        if least.ratio < OVERSTATED:
            found.append(f"the residual is only {least.ratio:.2f} times as large as the stated noise")
        if min(one.freedom for one in self.goodness.values()) < FREEDOM:
            found.append("too few pixels are valid")
        return tuple(found)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was changed or may be wrong, and what the frames do not determine, one sentence each."""
        found = list(self.remedies)
        for names in self.undetermined:
            what = names[0] if len(names) == 1 else f"a common change of {', '.join(names)}"
            found.append(f"these frames do not determine {what}, so the fit does not follow it")
        if self.depth_scale:
            shares = ", ".join(f"{name} by {share:.1f} %" for name, share in self.depth_scale.items())
            found.append(
                f"scale of the depths, taken as known: if all depths are 1 % larger, so are {shares}, and H hardly "
                "changes; only a target or a known step of the stage determines millimetres"
            )
        return tuple(found)

    @property
    def accepted(self) -> bool:
        """Whether there are no `objections`; otherwise the values may be wrong by many standard deviations."""
        return not self.objections

    @property
    def verdict(self) -> str:
        """Verdict on the recalibration, as one sentence."""
        if self.objections:
            return f"not recalibrated: {', and '.join(self.objections)}"
        count = f"{len(self.goodness)} frame{'s' if len(self.goodness) > 1 else ''}"
        return f"recalibrated from {count}, goodness of fit {self.worst:.2f}"


def iter_recalibrate(
    frames: Sequence[NewFrame],
    plan: ScanPlan,
    *,
    noise: tuple[float, float] | None = None,
    unknowns: Sequence[str] | None = None,
    effects: Sequence[Effect] | None = None,
    windows: int | None = None,
    workers: int | None = None,
    steps: Path | None = None,
) -> Work[Recalibration]:
    """Fit the camera to frames of unknown objects, and return the `Recalibration`.

    For each frame, the object and the dark field are estimated together with the camera. Changes of the frame that a
    change of the object could also cause do not count as information on the camera.

    Parameters
    ----------
    frames
        Frames of the whole sensor, with their dark level subtracted, that show any structured objects within the depths
        of the plan.
    plan
        Scan with the described camera, the depth planes, and a cutout that contains the patterns.
    noise
        Variance of a sample without light (counts²), and its increase per count of signal. None: as the frames state.
    unknowns
        Groups of unknowns to fit. None: those of `DETERMINED` that the camera has.
    effects
        Effects to simulate. None: those that follow from the description of the camera.
    windows
        Number of windows of the sensor to use. None: one, or five for a large sensor. Their size depends on the free
        memory, because only one window is in memory at a time.
    workers
        Number of threads. None: all processors.
    steps
        Folder in which finished steps are stored, one for each round and window. If it contains those of the same fit,
        the fit continues from them. None: no steps are stored.

    Yields
    ------
    Progress
        In windows, for each round.

    Raises
    ------
    InputError
        If there are no frames, or if the noise of a frame is unknown, its shape is not that of the sensor, or its
        structure does not exceed the noise. If a group of unknowns cannot be fitted, no window has valid pixels in all
        frames, or memory is insufficient. Also if ``steps`` contains those of another fit, or the camera has no lenslet
        lattice.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.recalibrate import iter_recalibrate
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3, 4], cutout=49)
    >>> work = iter_recalibrate([], plan)
    >>> next(work)
    Traceback (most recent call last):
    lfcal.base.errors.InputError: frames: expected at least one, got none; give frames of structured objects
    """
    if not frames:
        raise InputError.expected("frames", "at least one", "none", "give frames of structured objects")
    if not plan.camera.has_lattice:
        raise NoLatticeError.of("recalibration on frames")
    begins = starting_effects(plan) if effects is None else tuple(effects)
    setup = Setup(plan.camera, begins, (0.0,) * len(plan.depths_um))
    without = lacking(setup, plan)
    groups = tuple(name for name in DETERMINED if name not in without) if unknowns is None else tuple(unknowns)
    check_groups(setup, plan, groups)
    wholes: dict[str, ObjectFrame] = {}
    for frame in frames:
        name = distinct_label(frame.label, wholes)
        wholes[name] = whole_frame(frame, name, plan, noise)
    places = windows_within(plan, windows, COPIES, every=False)
    stored = Steps(
        steps, _key(setup, plan, groups, wholes.values(), windows), {"windows": [one.place for one in places]}
    )
    every = [SensorWindow.at(plan, *place) for place in stored.settings["windows"]]
    own = [(window, [in_window(whole, window) for whole in wholes.values()]) for window in every]
    lit = [(window, parts) for window, parts in own if all(one.valid.any() for one in parts)]
    if not lit:
        raise InputError.expected(
            "frames", "valid pixels in a window of the sensor", "none", "check mask and saturation level"
        )
    scales = ScanScales.over([window.plan for window, _ in lit]) if len(lit) > 1 else ScanScales.of(lit[0][0].plan)
    fit = _Run(lit, plan, Vector(setup, scales, groups), stored, workers)
    return (yield from fit.iter_found())


def _key(
    setup: Setup, plan: ScanPlan, groups: Sequence[str], frames: Iterable[ObjectFrame], windows: int | None
) -> str:
    """Return a text that differs between fits to different frames or with different settings."""
    found = hashlib.sha256(repr((plan.to_dict(), setup.effects, groups, windows, ROUNDS)).encode())
    for frame in frames:
        found.update(repr((frame.name, frame.read_e, frame.prnu)).encode())
        found.update(frame.electrons.tobytes() + frame.valid.tobytes())
    return found.hexdigest()


recalibrate = drained(
    iter_recalibrate,
    """
    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.recalibrate import recalibrate
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3, 4], cutout=49)
    >>> recalibrate([], plan)
    Traceback (most recent call last):
    lfcal.base.errors.InputError: frames: expected at least one, got none; give frames of structured objects
    """,
)


@dataclass(frozen=True, eq=False)
class _At:
    """A vector of unknowns, with the information about it and the goodness of fit of each frame."""

    u: F8
    information: F8
    goodness: dict[str, Goodness]
    contents: Contents
    grid: F8
    """Error of the unknowns because objects are not on the grid of voxels, as far as it is known."""

    @property
    def worst(self) -> float:
        """Largest goodness of fit."""
        return max(one.ratio for one in self.goodness.values())


class _Run:
    """The frames of all windows, and the rounds of a fit to them."""

    def __init__(
        self,
        lit: Sequence[tuple[SensorWindow, Sequence[ObjectFrame]]],
        plan: ScanPlan,
        vector: Vector,
        steps: Steps,
        workers: int | None,
    ) -> None:
        self.lit, self.plan, self.vector, self.steps, self.workers = lit, plan, vector, steps, workers
        precision, _ = vector.prior()
        self.precision = np.where(precision > 0, precision, UNCERTAINTY**-2)

    def iter_found(self) -> Work[Recalibration]:
        """Fit the camera; if it does not explain the frames, look for the reason, and fit again with its remedy."""
        begin = Contents(self.plan.depths_um)
        self._note_forecast(begin)
        at = yield from self._iter_fit(begin, "recalibration")
        words: tuple[str, ...] = ()
        if at.worst > ALARM:
            at, words = yield from self._iter_remedied(at)
        return self._summary(at, words)

    def _note_forecast(self, contents: Contents) -> None:
        """Report the windows, and the processor time and memory that the fit needs."""
        models = self._models(contents)
        seconds = processor_seconds(models[0], self.vector.setup, ROUNDS, len(models), len(self.vector))
        shape, count = format_pixels(self.lit[0][0].shape), len(models)
        note(
            f"{count} window{'s' if count > 1 else ''} of {shape}, about {format_seconds(seconds)} of processor time, "
            f"memory {format_bytes(models[0].memory)}; more if a remedy is needed"
        )

    def _models(self, contents: Contents) -> list[WindowModel]:
        models = [WindowModel(window, frames, contents, self.workers) for window, frames in self.lit]
        free = ROOM * free_memory()
        if free and models[0].memory > free:
            raise InputError.expected(
                "memory for the patterns of a window",
                f"at least {format_bytes(models[0].memory)}",
                f"{format_bytes(free)} that may be used",
                "choose a smaller cutout or fewer planes",
            )
        return models

    def _iter_fit(self, contents: Contents, stage: str) -> Work[_At]:
        count = len(self.vector)
        u, models, total = np.zeros(count), self._models(contents), Score.none(count + 1)
        clock, derivatives = Clock(stage, (len(ROUNDS) + 1) * len(models)), dict[int, F4]()
        yield clock.at(0)
        for turn, how in enumerate(ROUNDS):
            total = Score.none(count + 1)
            for k, model in enumerate(models):
                step = self.steps.result(partial(self._scored, model, u, how, derivatives.get(k)))
                derivatives[k] = step["derivatives"] if "derivatives" in step else derivatives[k]
                total += Score(step["information"], step["gradient"])
                yield clock.at(turn * len(models) + k + 1)
            own = total.information[:count, :count]
            target = Modes.of(own, self.precision).estimate(total.gradient[:count] + own @ u)
            u = self.vector.clipped(u + np.clip(target - u, -LONGEST, LONGEST))
        goodness: dict[str, Goodness] = {}
        for k, model in enumerate(models):
            values = self.steps.result(partial(self._goodness, model, u))["goodness"]
            for frame, value in zip(model.frames, values.tolist(), strict=True):
                one = Goodness(*value)
                goodness[frame.name] = max(one, goodness.get(frame.name, one))
            yield clock.at(len(ROUNDS) * len(models) + k + 1)
        return _At(u, total.information, goodness, contents, np.zeros(count))

    def _scored(self, model: WindowModel, u: F8, how: Round, earlier: F4 | None) -> Arrays:
        """Return the score of the frames in a window in a round, and the derivatives if they were computed again."""
        iterations, sampling, bright = how
        patterns = model.patterns(self.vector.setup_at(u), sampling)
        scenes = model.scenes(patterns, iterations)
        found: dict[str, F4 | F8] = {}
        if earlier is None or bright:
            earlier = found["derivatives"] = model.derivatives(self.vector, u, patterns, scenes, sampling, bright)
        score = model.score(patterns, scenes, earlier)
        return {**found, "information": score.information, "gradient": score.gradient}

    def _goodness(self, model: WindowModel, u: F8) -> Arrays:
        """Return the goodness of fit of the frames in a window, one row for each frame."""
        iterations, sampling, _ = ROUNDS[-1]
        patterns = model.patterns(self.vector.setup_at(u), sampling)
        return {"goodness": np.array(model.goodness(patterns, model.scenes(patterns, iterations)), np.float64)}

    def _iter_remedied(self, at: _At) -> Work[tuple[_At, tuple[str, ...]]]:
        """Return the first fit with a remedy that explains the frames, otherwise ``at``, and the finding as text.

        A fit with wrong assumptions moves the camera away, so each remedy needs a fit from the start. The error due to
        the grid of voxels decreases at least in proportion to their distance. What is left with voxels of half a pixel
        is therefore at most the difference from the fit with whole ones.
        """
        best, reason, untried = at, "", ""
        for one in _remedies(self.plan):
            try:
                again = yield from self._iter_fit(one.contents, f"recalibration with {one.remedy}")
            except (InputError, EnergyError) as error:  # the engine cannot compute these planes, or memory is short
                untried += f"; not tried: {one.remedy} ({error})"
                continue
            if one.contents.halves:
                again = replace(again, grid=np.abs(again.u - at.u))
            if again.worst <= ALARM:
                return again, (f"{one.reason}; the fit was repeated with {one.remedy}",)
            if again.worst - 1 < HELPS * (best.worst - 1):
                best, reason = again, f"{one.reason}: with {one.remedy}, the goodness of fit is {again.worst:.2f}"
        words = reason or (
            "neither other planes, nor smaller voxels, nor a structured dark field explain the frames: the "
            "optics may have an effect that is not described, or the noise may be larger than stated"
        )
        return at, (words + untried,)

    def _summary(self, at: _At, words: tuple[str, ...]) -> Recalibration:
        information = at.information[:-1, :-1]
        modes = Modes.of(information, self.precision)
        sigmas = np.hypot(np.sqrt(np.diag(modes.covariance) * max(1.0, at.worst)), at.grid)
        along = -modes.estimate(at.information[:-1, -1])
        found, scale = {}, {}
        for k, one in enumerate(self.vector.unknowns):
            u, sigma = float(at.u[k]), float(sigmas[k])
            floor = FLOORS.get(one.group, 0.0) * abs(one.start)
            value, held = one.value(u), information[k, k] + self.precision[k]
            known = math.hypot(one.sigma_of(u, sigma), floor)
            found[one.name] = Parameter(
                one.name, one.group, one.unit, value, known, one.start, one.sigma_of(u, 1 / math.sqrt(held))
            )
            share = (one.value(u + float(along[k])) - value) / (DEPTH_SCALE * value) if value else 0.0
            if abs(along[k]) > CLEAR * sigma and abs(share) > LEAST_SHARE:
                scale[one.name] = share
        setup = self.vector.setup_at(at.u)
        weak = modes.undetermined(tuple(found))
        return Recalibration(setup, self.plan, found, at.goodness, at.contents, words, weak, scale)


def _remedies(plan: ScanPlan) -> list[Remedy]:
    """Return what may be wrong with the assumptions about the contents of frames, the fastest to try first."""
    own = Contents(plan.depths_um)
    between, small = "objects between or outside the planes", "objects smaller than a pixel, between the voxels"
    return [
        Remedy("a dark field with structure", "a smooth dark field of 8 x 8 parts", replace(own, dark_parts=8)),
        Remedy(between, "more planes", replace(own, depths_um=_closer(plan))),
        Remedy(small, "voxels of half a pixel", replace(own, halves=True)),
    ]


def _closer(plan: ScanPlan) -> tuple[float, ...]:
    """Return the depths of a plan plus one in each gap and half a step beyond each end, in virtual depth if known."""
    camera, order = plan.camera, plan.depths_um[0] > plan.depths_um[-1]
    at = np.array(plan.virtual_depths or plan.depths_um)
    step = np.diff(at) if len(at) > 1 else np.array([0.5 if plan.virtual_depths else 0.1 * max(1.0, abs(at[0]))])
    more = np.concatenate([at, at[:-1] + np.diff(at) / 2, [at[0] - step[0] / 2, at[-1] + step[-1] / 2]])
    depths: list[float] = [] if plan.virtual_depths else more.tolist()
    for v in more.tolist() if plan.virtual_depths else ():
        with suppress(InputError):  # no object in front of a main lens is imaged there
            depths += [camera.depth_of(v)] if abs(v) >= 1 else []
    return tuple(sorted(depths, reverse=order))
