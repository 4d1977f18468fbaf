"""A target in front of the true bench camera: frames with every effect, and the description that a user has."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks._fit_cameras import Truth, random_truth
from lfcal.base.progress import Work
from lfcal.camera import ScanPlan, preset
from lfcal.fit.model import Fineness, predict
from lfcal.fit.setup import Setup
from lfcal.fit.spread import spread_out
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.frames.source import FrameSource
from lfcal.simulate.effects import (
    Distortion,
    MechanicalVignetting,
    Quantisation,
    ReadNoise,
    ShotNoise,
)
from lfcal.simulate.effects.base import Effect
from lfcal.simulate.engines.base import Sampling
from lfcal.targets import Pose, Target, TargetCamera, TargetPlan, uneven
from lfcal.targets.frames import TargetFrames

__all__ = ["TargetScene", "target_scene"]

SIDE, CUTOUT, DEPTH = 720, 49, 4.0
"""Pixels of the sensor and of a pattern, and the virtual depth of the plane."""

HOLES, PITCH_PX, HOLE_UM = 12, 57.0, 20.0
MARKS = ((0, 0), (0, 1), (1, 0))
SPREAD = 0.1
"""Relative rms scatter of the brightness of holes."""

FINE = Sampling(samples_per_px=6.0, margin_px=24)
"""Sampling of the frames, which is finer than that of the fit and includes light at large angles."""

LOOKED_AT = 24
"""Positions of a region at which an H is compared with the true one."""


@dataclass(frozen=True, eq=False)
class TargetScene:
    """A true and a described camera, and the plan of a target in front of it.

    Attributes
    ----------
    plan
        Plan of the user: the described camera, and the target as ordered, without rotation and tilt.
    really
        The target with its true pose.
    truth
        The true camera.
    light
        Effects on the frames that are not part of ``truth``: cat's eye, distortion.
    seed
        Seed of brightness and noise.
    """

    plan: TargetPlan
    really: Target
    truth: Truth
    light: tuple[Effect, ...]
    seed: int

    @property
    def true_plan(self) -> ScanPlan:
        """The scan with the true camera."""
        return replace(self.plan.scan, camera=self.truth.setup.camera)

    def camera(self, sampling: Sampling = FINE) -> TargetCamera:
        """Return the coherent simulator of the frames, with the true position, depth and size of every hole."""
        effects = (*self.truth.setup.effects, *self.light, ShotNoise(), ReadNoise(), Quantisation())
        plan = replace(self.plan, scan=self.true_plan)
        brightness = uneven(self.really, SPREAD, self.seed)
        return TargetCamera(
            plan, effects, really=self.really, brightness=brightness, level="grid", sampling=sampling, seed=self.seed
        )

    def iter_frames(self, camera: TargetCamera, workers: int | None = None) -> Work[NDArray[np.uint16]]:
        """Return all frames ``(n, rows, columns)`` in sample values; yields progress."""
        lights = yield from camera.iter_lights(workers=workers)
        return np.stack([camera.exposed(light, k).astype(np.uint16) for k, light in enumerate(lights)])

    def view(self, frames: NDArray[np.uint16]) -> FrameSource:
        """Return frames as a user has them: with the plan, after subtraction of the dark level."""
        count = len(frames)
        plan = self.plan_of(count)
        source = ArraySource(frames, [(0, 0, k) for k in range(count)])
        return corrected_view(TargetFrames(source, plan), CorrectionRecipe(), plan.scan)

    def plan_of(self, count: int) -> TargetPlan:
        """Return the plan of the first ``count`` frames."""
        return replace(self.plan, offsets_px=(self.plan.offsets_px[0][:count],))

    def true_patterns(self, plan: ScanPlan) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Return some positions of a region ``(n, 3)``, and the true patterns of a point there ``(n, nt, ns)``."""
        every = np.argwhere(np.ones(plan.shape[:3], np.bool_))
        at = every[spread_out(every, LOOKED_AT, plan.period)]
        return at, self.true_light(plan, at)

    def true_light(self, plan: ScanPlan, at: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the true patterns ``(n, nt, ns)`` of points at positions of a region, as fractions of the light."""
        cats_eye = tuple(one for one in self.light if isinstance(one, MechanicalVignetting))
        setup = replace(self.truth.setup, effects=(*self.truth.setup.effects, *cats_eye))
        return predicted(setup, plan, at)


def predicted(setup: Setup, plan: ScanPlan, at: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the patterns ``(n, nt, ns)`` of a setup at positions of a scan, computed at the finest sampling."""
    still = np.zeros((len(at), 2))
    return predict(setup, plan, at, still, Fineness.finest).astype(np.float64)


def target_scene(frames: int, seed: int = 0, *, wrong: bool = True) -> TargetScene:
    """Return the scene with a number of frames.

    If ``wrong``, the camera differs from its description as in ``benchmarks.fit``: by 1 to 3 % in gap and focal
    lengths, 5 % in the iris, 0.3 waves of aberrations, and a displaced array. Its cat's eye is stronger than the
    typical one, with which a fit starts.
    """
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, shape=(SIDE, SIDE)))
    scan = ScanPlan.for_camera(camera, virtual_depths=(DEPTH,), cutout=CUTOUT)
    step = camera.step_um(scan.depths_um[0])
    pitch = PITCH_PX * step
    target = Target("square", (HOLES, HOLES), (pitch, pitch), HOLE_UM, MARKS)
    really = replace(target, pose=Pose(rotation_rad=math.radians(1.0), tilt_right_rad=math.radians(2.0)))
    offsets = tuple(_spread_out(frames, scan.period))
    plan = TargetPlan(scan, target, (offsets,), 0.1, (0.005,), "geometric")
    truth = random_truth(scan, np.random.default_rng(seed)) if wrong else _described(scan)
    light = (MechanicalVignetting(32e3, 1.03), Distortion(-0.002, 2000.0))
    return TargetScene(plan, really, truth, light, seed)


def _described(scan: ScanPlan) -> Truth:
    from lfcal.fit.setup import described_effects

    setup = Setup(scan.camera, described_effects(scan.camera), (0.0,))
    return Truth(scan, setup, {})


def _spread_out(count: int, period: tuple[int, int]) -> list[tuple[float, float]]:
    """Return offsets that are evenly spread over a period about its middle (Roberts' sequence)."""
    g = 1.32471795724474602596
    steps = np.arange(1, count + 1)
    shares = np.stack([(steps / g) % 1.0, (steps / g**2) % 1.0], axis=1) - 0.5
    moved = np.round(shares * np.array(period), 3)
    return [(float(row), float(column)) for row, column in moved.tolist()]
