"""H of frames that show several subsets of a display's points at once, against one subset after the other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.campaign.point_assembly import iter_assemble_points
from lfcal.campaign.points import measured_points, points_of
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.frames.source import FrameSource
from lfcal.multiplex import s_matrix
from lfcal.psf import AssemblySettings, PSFMatrix
from lfcal.simulate.effects import Quantisation, ReadNoise, ShotNoise
from lfcal.targets import Display, TargetCamera, TargetPlan, Wishes, coded_plan, decoded, iter_plan_display
from lfcal.targets.frames import TargetFrames
from tests.targets.common import scan_of, small

SCAN, PEAK = scan_of(small(160)), 0.01
"""200 electrons in a point's brightest pixel, 8 of read noise."""


def view_of(plan: TargetPlan, frames: np.ndarray) -> FrameSource:
    source = ArraySource(frames, [(0, 0, k) for k in range(len(frames))])
    level = CorrectionRecipe(black_level=float(SCAN.camera.sensor.black_level))
    return decoded(corrected_view(TargetFrames(source, plan), level, plan.scan), plan)


@pytest.mark.long
def test_at_low_light_h_of_sums_is_better_at_equal_time(tmp_path: Path) -> None:
    plan = drain(iter_plan_display(SCAN, Display((2000, 2000), 5.0), Wishes(0.3, 0.02, 7)))
    coded = coded_plan(plan, s_matrix(7), 5.0)
    noise = (ShotNoise(), ReadNoise(), Quantisation())
    camera, other = (TargetCamera(plan, noise, level="geometric", peak=PEAK, seed=seed) for seed in (0, 1))
    lights = drain(camera.iter_lights(workers=1))
    sums = [sum(lights[m] for m in lit) for lit in coded.lit[0]]
    sensor = SCAN.camera.sensor
    recorded = {
        "one": (plan, np.stack([camera.exposed(light, k) for k, light in enumerate(lights)])),
        "many": (coded, np.stack([other.exposed(light, k) for k, light in enumerate(sums)])),
        "true": (plan, (lights / sensor.electrons_per_count + sensor.black_level).astype(np.float32)),
    }
    assert recorded["one"][1].shape == recorded["many"][1].shape, "as many frames, of the same exposure"
    found: dict[str, PSFMatrix] = {}
    for name, (own, frames) in recorded.items():
        settings = AssemblySettings(strict=False)
        work = iter_assemble_points(view_of(own, frames), own, tmp_path / f"{name}.h5", settings)
        found[name] = drain(work).report.matrix
    both = np.argwhere(np.logical_and.reduce([np.asarray(one.recorded) > 0 for one in found.values()]))
    assert len(both) > 15
    one, many, true = (np.stack([np.asarray(H[tuple(at)]) for at in both.tolist()]) for H in found.values())

    def error(patterns: np.ndarray) -> float:
        gain = float((patterns * true).sum() / np.square(patterns).sum())
        return float(np.sqrt(np.square(gain * patterns - true).mean() / np.square(true).mean()))

    assert error(many) < 0.85 * error(one)
    # and what is stated of the noise of a pattern is what it has
    stated = []
    for own, frames in (recorded["one"], recorded["many"]):
        view = view_of(own, frames)
        stated.append(measured_points(view, points_of(view, own), (1, 1)).noise[:, 0].mean())
    assert stated[1] < stated[0]
