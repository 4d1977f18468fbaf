"""Simulate H (in one pass, in several, or for several regions), frames of a session, or only forecast the cost."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work, format_bytes, format_seconds, note, warn
from lfcal.records import (
    opt,
    read_effect,
    read_share,
    record,
    required,
)
from lfcal.tasks.cameras import is_camera_file, preset_names
from lfcal.tasks.planned import (
    cutout_field,
    depths_field,
    planned_scan,
    ready_regions,
    virtual_depths_field,
)
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.psf import PSFMatrix
    from lfcal.simulate import EffectSelection, UndescribedEffects

__all__ = [
    "SIMULATE",
    "SimulateForecast",
    "SimulateFrames",
    "SimulateH",
    "SimulatePasses",
    "SimulateRegions",
    "SimulatedFrames",
    "SimulatedH",
    "SimulatedRegions",
    "SimulationForecast",
]

LEVELS = ("auto", "geometric", "wave", "grid", "microscope", "reference")

LEAST_LIGHT = 0.9
"""Fraction of a plane's light in the cutout below which the cutout is reported as too small."""

MOST_DRIFT = 0.5
"""Drift of the lattice over the sensor relative to the period of H (px), above which it is reported."""


@dataclass(frozen=True, kw_only=True)
class SimulationForecast(TaskResult):
    """Effects selected for the simulation of a plan, with the reason and the cost of each.

    ``camera`` is the preset or the camera file to name in suggested commands. ``engines`` are the engines expected for
    the planes; empty once H or frames are simulated.
    """

    plan: ScanPlan
    effects: EffectSelection
    camera: str
    engines: tuple[str, ...] = ()

    @property
    def undescribed(self) -> UndescribedEffects:
        """Relevant effects that the camera does not describe, and the measurements that determine them."""
        from lfcal.simulate import undescribed_effects

        return undescribed_effects(self.effects, self.plan.camera)

    @property
    def undescribed_words(self) -> tuple[str, ...]:
        """One sentence on the effects in `undescribed`; an empty tuple if there are none."""
        return tuple(filter(None, (self.undescribed.sentence,)))

    @property
    def reached(self) -> tuple[str, ...]:
        """Accuracy of the computed planes of H, as lines of text; empty for a forecast."""
        return ()

    def _values(self) -> dict[str, Any]:
        assumed = self.plan.camera.marks.paths("assumed")
        missing = self.undescribed.to_dict(self.camera)
        return {**self.effects.to_dict(), "engines": self.engines, "undescribed": missing, "assumed": assumed}

    def written(self, path: Path, what: str, **more: Any) -> dict[str, Any]:
        """Return a summary of the file or folder ``path`` that was written.

        ``what`` describes its contents, and ``more`` contains further entries.
        """
        names = [effect.name for effect in self.effects.effects]
        assumed = self.plan.camera.marks.paths("assumed")
        missing = self.undescribed.to_dict(self.camera)
        return {"path": path, "what": what, **more, "effects": names, "undescribed": missing, "assumed": assumed}


@dataclass(frozen=True, kw_only=True)
class SimulatedH(SimulationForecast):
    """One simulated H; if it is one of several regions, its matrix is already closed.

    ``stored`` is the relative L1 error that writing the file may add to each pattern. None: it adds none. ``light`` is
    the fraction of the light of each plane that is inside the cutout.
    """

    out: Path
    matrix: PSFMatrix
    stored: float | None
    light: tuple[float, ...]

    @property
    def errors(self) -> tuple[float, ...]:
        """Relative L1 error of each plane due to omitted effects, computation and storage together."""
        return tuple(float(error) for error in self.matrix.facts.known()["error"])

    @property
    def planes(self) -> tuple[dict[str, Any] | None, ...]:
        """For each plane, a record of its computation (engine, sampling, times and error); None if unknown."""
        from lfcal.psf import simulated_planes

        return tuple(simulated_planes(self.matrix.provenance, len(self.plan.depths_um)))

    @property
    def limit(self) -> float:
        """Largest allowed relative L1 error of each plane: the tolerance of the simulation plus ``stored``."""
        return self.effects.tolerance + (self.stored or 0)

    @property
    def reached(self) -> tuple[str, ...]:
        """Error of the planes, how they were computed, and their light in the cutout, as lines of text."""
        from lfcal.psf import computed_words

        lowest, highest = 100 * min(self.errors), 100 * max(self.errors)
        error = f"{highest:.2g} %" if highest < 1.1 * lowest else f"{lowest:.2g} to {highest:.2g} %"
        what = "including that of storage" if self.stored is not None else "of omitted effects and of the computation"
        least, most = 100 * min(self.light), 100 * max(self.light)
        return (
            f"error {what}: {error} ({100 * self.limit:.3g} % allowed)",
            *computed_words(self.planes),
            f"light in the cutout: {least:.3g}" + ("" if most - least < 0.1 else f" to {most:.3g}") + " %",
        )

    def close(self) -> None:
        """Close the file of the matrix."""
        self.matrix.close()

    def _values(self) -> dict[str, Any]:
        return self.written(
            self.out,
            f"H {self.matrix.shape}",
            shape=self.matrix.shape,
            level=self.matrix.provenance["simulated"]["level"],
            tolerance=self.effects.tolerance,
            planes=self.planes,
            error=self.errors,
            light_in_cutout=self.light,
            predicted_seconds=self.effects.seconds,
        )


@dataclass(frozen=True, kw_only=True)
class SimulatedRegions(TaskResult):
    """H of several regions of the field in one file; the matrices are closed."""

    out: Path
    regions: Mapping[str, SimulatedH]

    @property
    def reached(self) -> tuple[str, ...]:
        """Accuracy of the planes of each region, as lines of text."""
        return tuple(words for one in self.regions.values() for words in one.reached)

    @property
    def undescribed_words(self) -> tuple[str, ...]:
        """One sentence on relevant effects that the camera does not describe; an empty tuple if there are none.

        It is that of the first region with such effects.
        """
        return tuple(dict.fromkeys(words for one in self.regions.values() for words in one.undescribed_words))[:1]

    def _values(self) -> dict[str, Any]:
        reported = {name: one.to_dict() for name, one in self.regions.items()}
        return {
            "path": self.out,
            "what": f"H of {len(reported)} regions",
            "out": self.out,
            # the file of a region is removed once all are merged
            "regions": {name: {k: v for k, v in one.items() if k != "path"} for name, one in reported.items()},
            "file_bytes": self.out.stat().st_size,
            "assumed": next(iter(reported.values()))["assumed"],
        }


@dataclass(frozen=True, kw_only=True)
class SimulatedFrames(SimulationForecast):
    """Simulated frames of a session; ``count`` does not include dark and white frames."""

    folder: Path
    count: int

    def _values(self) -> dict[str, Any]:
        return self.written(self.folder, f"{self.count} frames, dark and white frames, plan", frames=self.count)


@record
class _Simulate(Task):
    """Fields of all kinds of simulations."""

    name: ClassVar[str] = "simulate"

    camera: str = required(
        "Preset, camera file (.json, Raytrix XML …), or scan plan (.json).",
        argument=True,
        file="in",
        is_path=is_camera_file,
        examples=preset_names,
    )
    effects: tuple[str, ...] = opt(
        (),
        "Effect to switch on or off, or to set: NAME=on, off, auto or a magnitude (coma=0.3@40deg, "
        "lenslet_gap=5um); or a JSON file of effects. May be repeated.",
        flag="--effect",
        read=read_effect,
        file="in",
        is_path=lambda text: "=" not in text,
        empty="the effects that matter for the tolerance",
    )
    tolerance: float = opt(
        0.03,
        "Largest relative L1 error of H, from omitted effects and from the computation.",
        above=0,
        at_most=4,
        read=read_share,
    )
    level: str = opt(
        "auto",
        "Model of light propagation, from fast to accurate. geometric: rays. wave: waves from each lenslet "
        "separately. grid (main lens), microscope (objective): waves from all lenslets together. reference: the most "
        "accurate. auto: the fastest that keeps the tolerance.",
        choices=LEVELS,
    )

    @property
    def camera_name(self) -> str:
        """Preset or file of the camera for suggested commands; ``camera.json`` if ``camera`` is a plan."""
        return "camera.json"

    def selection(self, plan: ScanPlan, tolerance: float | None = None, **more: Any) -> EffectSelection:
        """Return the effects that matter for a plan; ``more`` is passed to `lfcal.simulate.plan_effects`."""
        from lfcal.simulate import plan_effects
        from lfcal.simulate.effects import parse_effects

        settings, given = parse_effects(self.effects)
        return plan_effects(plan, tolerance or self.tolerance, settings, effects=given, **more)

    def timed(self, plan: ScanPlan, found: EffectSelection) -> EffectSelection:
        """Return the effects at the requested level, with the processor time for H estimated by a short run."""
        from lfcal.simulate import predict_seconds

        seconds = predict_seconds(plan, found, self.level, tolerance=self.tolerance)
        return replace(found, level=found.level if self.level == "auto" else self.level, seconds=seconds)

    def known(self, plan: ScanPlan, found: EffectSelection) -> dict[str, Any]:
        """Return the provenance: plan, task, and the sources of the given magnitudes."""
        from lfcal.simulate.effects import effect_entries

        names = {effect.name for effect in found.effects}
        given = [one for one in effect_entries(self.effects) if one.given and one.name in names]
        return {
            "plan": plan.to_dict(),
            "task": self.to_dict(absolute=True, outputs=False),
            "effect_sources": {one.name: dict(one.given) for one in given},
        }

    def iter_matrix(
        self,
        plan: ScanPlan,
        out: Path,
        run: RunSettings,
        *,
        stored: float | None = None,
        on_pass: Callable[[PSFMatrix], None] | None = None,
    ) -> Work[SimulatedH]:
        """Choose the effects and compute H into ``out``, in units if this kind supports them.

        Parameters
        ----------
        plan, out, run
            The plan to simulate, the file to write, and the settings of the run.
        stored
            As in `SimulatedH`.
        on_pass
            Function to call with the H of each pass. None: H is not computed in passes.
        """
        from lfcal.simulate import iter_refine_psf, iter_simulate_psf, light_in_cutout, predict_bytes

        found = self.timed(plan, self.selection(plan))
        _note_plan(plan, found)
        choice = run.choice(out, found.seconds) if self.in_units else None
        how: dict[str, Any] = {"tolerance": self.tolerance, "workers": run.workers, "run": choice}
        most = predict_bytes(plan, found, self.level, **how, to_file=True, store_tolerance=stored)
        # the user can still stop and choose a larger tolerance
        note(
            f"prediction: about {format_seconds(found.seconds)} of processor time, at most "
            f"{format_bytes(most)} of memory"
        )
        how |= {"out": out, "provenance": self.known(plan, found)}
        if on_pass is None:
            matrix = yield from iter_simulate_psf(plan, found, self.level, **how, store_tolerance=stored)
        else:
            passes = (lambda tolerance: self.selection(plan, tolerance), self.level)
            matrix = yield from iter_refine_psf(plan, *passes, **how, on_pass=on_pass)
        light = tuple(light_in_cutout(matrix, plan, found))
        known: dict[str, Any] = {"plan": plan, "effects": found, "camera": self.camera_name}
        made = SimulatedH(**known, out=out, matrix=matrix, stored=stored, light=light)
        _warn(made, finest=self.level == "auto")
        return made


@record
class _OfOnePlan(_Simulate):
    """Fields of simulations of one plan, or of a camera with planes."""

    depths: tuple[float, ...] = depths_field("the planes of the plan")
    virtual_depths: tuple[float, ...] = virtual_depths_field("the planes of the plan")
    cutout: tuple[int, int] | None = cutout_field("the plan")

    @property
    def camera_name(self) -> str:
        """Preset or file of the camera for suggested commands; ``camera.json`` if ``camera`` is a plan."""
        return shlex.quote(self.camera) if self.depths or self.virtual_depths else super().camera_name

    def work(self, run: RunSettings | None = None) -> Work[tuple[Any, ...]]:
        """Simulate the plan, or show the expected cost."""
        plan = planned_scan(self.camera, self.depths, self.virtual_depths, self.cutout)
        made = yield from self.work_on(plan, run or RunSettings())
        return (made,)

    def work_on(self, plan: ScanPlan, run: RunSettings) -> Work[Any]:
        """Simulate ``plan``, which replaces the plan or camera that `camera` names."""
        raise NotImplementedError


OUT: dict[str, Any] = {"label": "H file", "short": "-o", "file": "out", "chooses": True}
FRAMES: dict[str, Any] = {"label": "Folder of frames", "chooses": True}
PEAK: dict[str, Any] = {"label": "Brightest pixel", "unit": "fraction of the full well", "above": 0, "at_most": 1000}


@record
class SimulateH(_OfOnePlan):
    """Simulate the PSF matrix of a camera with the effects that matter for it.

    Examples
    --------
    >>> from lfcal.tasks import SimulateFrames, SimulateH, SimulatePasses, SimulateRegions
    >>> task = SimulateH(camera="bench", virtual_depths=(4,), cutout=(21, 21), level="geometric", out="small.h5")
    >>> (made,) = task.run()
    >>> with made.matrix as H:
    ...     print(H.shape, f"{made.light[0]:.0%} of the light is in the cutout")
    (1, 19, 33, 21, 21) ...% of the light is in the cutout
    >>> others = SimulatePasses(camera="plan.json", out="H.h5"), SimulateRegions(camera="regions.json", out="H.h5")
    >>> frames = SimulateFrames(camera="plan.json", frames="session", seed=3)
    """

    input_words: ClassVar[str] = "H in one pass"
    in_units: ClassVar[bool] = True

    out: Path = required("H file to write (.h5).", **OUT)
    store_tolerance: float | None = opt(
        None,
        "Largest relative L1 error that rounding and cropping may cause in a stored pattern, as in lfcal reduce.",
        label="Storage tolerance",
        above=0,
        below=1,
        empty="without loss",
        read=read_share,
        more=True,
    )

    def work_on(self, plan: ScanPlan, run: RunSettings) -> Work[SimulatedH]:
        """Choose the effects, and compute and write the H of ``plan``."""
        return self.iter_matrix(plan, self.out, run, stored=self.store_tolerance)


@record
class SimulatePasses(_OfOnePlan):
    """Simulate H in passes: it is complete after the first, and more accurate after each."""

    input_words: ClassVar[str] = "H in passes"
    in_units: ClassVar[bool] = True

    out: Path = required("H file to write (.h5).", **OUT)
    progressive: bool = opt(
        True,
        "Simulate H in passes. H is complete after the first pass, and becomes more accurate with each further pass. "
        "If you stop the simulation, the last complete H is kept.",
        label="Simulate in passes",
        chooses=True,
    )

    def work_on(self, plan: ScanPlan, run: RunSettings) -> Work[SimulatedH]:
        """Compute the H of ``plan`` in increasingly accurate passes, and write it after each pass."""
        whole: list[str] = []

        def note_pass(matrix: PSFMatrix) -> None:
            worst = 100 * max(float(error) for error in matrix.facts.known()["error"])
            whole.append(f"{self.out} is complete with errors of at most {worst:.2g} %")
            note(f"{whole[-1]}; you can stop now and keep this file")

        try:
            return (yield from self.iter_matrix(plan, self.out, run, on_pass=note_pass))
        except BaseException:
            if whole:
                note(f"stopped; {whole[-1]}")
            raise


@record
class SimulateRegions(_Simulate):
    """Simulate H of each region of a plan at its position in the field, and write all to one file."""

    input_words: ClassVar[str] = "H of several regions"

    out: Path = required("H file to write (.h5).", **OUT)

    def work(self, run: RunSettings | None = None) -> Work[tuple[SimulatedRegions, ...]]:
        """Compute the H of each region, and write all of them to one file."""
        from lfcal.campaign import save_parts, temporary_parts

        run, several, made = run or RunSettings(), ready_regions(self.camera), {}
        if several is None:
            raise InputError.expected("plan", "a plan of several regions", self.camera, "simulate a single region")
        with temporary_parts(self.out, several.names) as parts:
            for k, name in enumerate(several.names):
                note(f"region {name}")
                made[name] = yield from self.iter_matrix(several.plan(k), parts[name], run)
                made[name].close()
            save_parts(parts, self.out, workers=run.workers)
        return (SimulatedRegions(out=self.out, regions=made),)


@record
class SimulateFrames(_OfOnePlan):
    """Simulate the frames of a session, with dark frames, white frames and the plan."""

    input_words: ClassVar[str] = "frames"

    frames: Path = required("New or empty folder for the frames of a simulated session.", file="out", **FRAMES)
    seed: int = opt(0, "Seed of the random noise and stage errors in the frames.", at_least=0, more=True)
    peak: float = opt(0.8, "Signal in the brightest pixel of the frames.", more=True, **PEAK)

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        The folder of frames is not included, because it is never replaced.
        """
        return () if way == "out" else super().files(way)

    def work_on(self, plan: ScanPlan, run: RunSettings) -> Work[SimulatedFrames]:
        """Simulate the frames of ``plan``, and write them."""
        from lfcal.simulate import SimulatedCamera, iter_write_session
        from lfcal.simulate.sensor import check_session_folder

        check_session_folder(self.frames, resume=run.resume)
        found = self.selection(plan, frames=True, peak=self.peak)
        _note_plan(plan, found)
        how: dict[str, Any] = {"tolerance": self.tolerance, "seed": self.seed, "peak": self.peak}
        source = SimulatedCamera(plan, found, level=self.level, **how)
        known = {"task": self.known(plan, found)["task"]}
        count = yield from iter_write_session(source, self.frames, resume=run.resume, provenance=known)
        return SimulatedFrames(plan=plan, effects=found, camera=self.camera_name, folder=self.frames, count=count)


@record
class SimulateForecast(_OfOnePlan):
    """Show which effects matter for a simulation and what they cost, without simulating.

    Examples
    --------
    >>> from lfcal.tasks import SimulateForecast
    >>> (found,) = SimulateForecast(camera="session/plan.json").run()
    >>> print(found.effects.level, found.effects.row("bandwidth").on)
    wave False
    """

    input_words: ClassVar[str] = "a forecast"

    plan_only: bool = opt(
        True,
        "Show which effects matter and how long they take to compute, without simulating.",
        label="Forecast only",
        chooses=True,
    )
    out: Path | None = opt(None, "H file of the planned simulation. It is not written.", **OUT | {"file": ""})
    frames: Path | None = opt(
        None,
        "Folder for the frames of the planned simulation. It affects the forecast only; nothing is written.",
        **FRAMES,
    )
    peak: float = opt(0.8, "Signal in the brightest pixel of the frames.", needs=("frames", ""), more=True, **PEAK)

    def work_on(self, plan: ScanPlan, run: RunSettings) -> Work[SimulationForecast]:
        """Choose the effects, and predict the cost of the simulation of ``plan``."""
        from lfcal.simulate import planned_engines

        yield from ()
        found = self.selection(plan, frames=self.frames is not None, peak=self.peak)
        _note_plan(plan)
        for target in filter(None, (self.out, self.frames)):
            note(f"{target} is not written, because of --plan-only")
        # the costs of effects are estimated without a run
        found = found if self.level == "auto" else self.timed(plan, found)
        engines = planned_engines(plan, found, self.level, tolerance=self.tolerance)
        return SimulationForecast(plan=plan, effects=found, camera=self.camera_name, engines=engines)


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task for the ``given`` output and plan."""
    if given.get("plan_only"):
        return SimulateForecast
    if bool(given.get("out")) == bool(given.get("frames")):
        both = bool(given.get("out"))
        raise InputError.expected(
            "output",
            "a file for H (-o H.h5) or a folder for frames (--frames DIR)",
            "both" if both else "neither",
            "leave one out, and simulate the other afterwards" if both else "add one of them, or --plan-only",
        )
    if ready_regions(str(given.get("camera", ""))) is not None:
        return SimulateRegions
    if given.get("frames"):
        return SimulateFrames
    return SimulatePasses if given.get("progressive") else SimulateH


SIMULATE = TaskSet(
    "simulate",
    (SimulateH, SimulatePasses, SimulateRegions, SimulateFrames, SimulateForecast),
    kind_of,
    "lfcal simulate bench --virtual-depths 3,4 -o H.h5",
)


def _note_plan(plan: ScanPlan, found: EffectSelection | None = None) -> None:
    """Report requested effects that are left out, and a period of H that does not match the lattice."""
    from lfcal.simulate.effects import CATALOGUE

    for reason in CATALOGUE.failures().values():
        note(f"left out: {reason}")
    for row in () if found is None else found.rows:
        if row.setting == "on" and not row.on:
            note(f"{row.name}: {row.reason}")
    # a plan with fewer positions than one period cannot drift relative to the lattice
    if not plan.resample and plan.drift_px > MOST_DRIFT and max(map(abs, plan.period_residual_px)) <= 0.5:
        (py, px), (ny, nx) = plan.camera.period_px, plan.period
        own = f"{py * plan.cells[0]:.5g} x {px * plan.cells[1]:.5g} px"
        note(
            f"the period of H, {ny} x {nx} px, does not match that of the lattice, {own}: they drift apart by "
            f"{plan.drift_px:.3g} px over the sensor; to remove the drift, make the plan with resampling (lfcal "
            "plan --resample); otherwise, a reconstruction resamples frames to the period of H"
        )


def _warn(made: SimulatedH, *, finest: bool) -> None:
    """Warn of planes that miss the requested accuracy, or whose cutout contains too little light.

    ``finest`` states whether no more accurate level can be chosen.
    """
    depths, errors, light = made.plan.depths_um, made.errors, made.light
    over = [z for z, error in enumerate(errors) if error > made.limit]
    if over:
        worst = max(over, key=lambda z: errors[z])
        more = "no more accurate level exists" if finest else "choose the level auto (--level)"
        warn(
            f"the error of {len(over)} of {len(errors)} planes exceeds the allowed {100 * made.limit:.3g} %; "
            f"it is {100 * errors[worst]:.2g} % in plane {worst} at {depths[worst]:g} µm; {more}"
        )
    low = [z for z, share in enumerate(light) if share < LEAST_LIGHT]
    if low:
        worst = min(low, key=lambda z: light[z])
        rows, columns = made.plan.cutout
        warn(
            f"the cutout of {rows} x {columns} px contains less than {100 * LEAST_LIGHT:g} % of the light in "
            f"{len(low)} of {len(light)} planes; plane {worst} at {depths[worst]:g} µm has "
            f"{100 * light[worst]:.3g} %; choose a larger cutout (--cutout)"
        )
