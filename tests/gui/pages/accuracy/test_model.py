"""What the Accuracy page measures, shows and changes, without a window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.accuracy import PARTS, CostPoint, Curve, Subject, measure_curve
from lfcal.base import InputError, drain
from lfcal.psf import PSFMatrix, save
from lfcal_gui.models import (
    MeasuredCurves,
    OpeningSettings,
    ProjectState,
    axis_labels,
    iter_measure,
    points_of,
    subject_of,
)
from lfcal_gui.models.cost import point_words
from lfcal_gui.pages.accuracy.model import NO_USE, AccuracySettings, in_use, subjects, use_of, words_of
from lfcal_gui.pages.accuracy.step import step
from lfcal_gui.pages.frames.model import FrameSettings
from lfcal_gui.pages.multiplex.model import MultiplexSettings
from lfcal_gui.pages.reconstruct.export_model import ExportSettings
from lfcal_gui.pages.reconstruct.model import ReconstructSettings
from lfcal_gui.pages.simulate.model import SimulateSettings
from tests.acquire.rigs import small_plan

PLAN = small_plan()


def curve(*points: CostPoint, part: str = "storage", stopped: str = "") -> Curve:
    made = Curve(
        part, "Title", "relative L1 error, of all", "time, in all", "seconds", "the values", (), ("a note",), stopped
    )
    for point in points:
        made = made.with_point(point)
    return made


def point(error: float, cost: float, **settings: Any) -> CostPoint:
    return CostPoint(f"point {cost:g}", settings, error, cost, "seconds", {"read (s)": 2.5}, "note")


def test_points_are_logarithms_with_the_front_and_the_pick() -> None:
    made = curve(point(0.1, 1.0), point(0.001, 100.0), point(0.5, 10.0), point(0.0, 1000.0))
    points = points_of(made, made.cheapest(0.05))
    assert [(p.x, p.y) for p in points[:3]] == [pytest.approx(v) for v in ((0, 1), (1, np.log10(50)), (2, -1))]
    assert [p.efficient for p in points] == [True, False, True, True]
    assert [p.picked for p in points] == [False, False, True, False]
    assert np.isfinite(points[3].y), "an error of nothing is shown, too"
    assert point_words(made.points[0], "10 %") == "point 1\nerror 10 %, costs 1.0 s\nread (s): 2.5\nnote"
    assert axis_labels(made) == ("time (s)", "relative L1 error (%)")
    sizes = Curve("storage", "Title", "error", "size of the file", "bytes")
    sizes = sizes.with_point(CostPoint("a", {}, 0.1, 2.5e7, "bytes"))
    assert axis_labels(sizes)[0] == "size of the file (MB)" and points_of(sizes, None)[0].x == pytest.approx(
        np.log10(25)
    )
    frames = Curve("planes", "Title", "error", "frames of the scan", "frames")
    assert axis_labels(frames)[0] == "frames of the scan"


def test_different_errors_never_read_the_same() -> None:
    used = point(0.0103, 0.254)
    made = curve(point(0.0099, 0.545), used)
    answer = words_of(made, 0.01, running=False, in_use=used)[0]
    assert answer == "An error of 1 % costs 545 ms: point 0.545 (0.99 %)\nIn use: point 0.254 (1.03 % for 254 ms)"
    words = [shown.words for shown in points_of(made, None, used, (0.01,))]
    assert "error 1.03 %," in words[0] and "error 0.99 %," in words[1]


def test_words_say_what_to_do_and_why_there_is_nothing() -> None:
    for found, running, words in (
        (None, False, "Not measured yet: press Measure."),
        (curve(), True, "measuring the reference …"),
        (curve(stopped="no camera"), False, "Not measured: no camera"),
        (
            curve(stopped="not begun: reference takes about 20 s"),
            False,
            "Not measured: not begun: reference takes about 20 s; increase the time per measurement",
        ),
    ):
        assert words_of(found, 0.01, running=running)[0] == words
    answer, how = words_of(curve(point(0.1, 1.0), stopped="ended after 10 s"), 0.2, running=False)
    assert answer == "An error of 20 % costs 1.0 s: point 1 (10 %)"
    assert how == "Measured by: the values.\na note\nended after 10 s"


def test_h_is_measured_and_closed(tmp_path: Path) -> None:
    save(PSFMatrix(np.random.default_rng(0).random((1, 2, 2, 3, 3)).astype(np.float32)), tmp_path / "H.h5")
    state, kept = replace(ProjectState(), psf=str(tmp_path / "H.h5")), MeasuredCurves()
    drain(iter_measure(state, "psf", 10.0, ("storage", "lattice"), kept))
    curves = kept.of(subject_of(state, "psf"))
    assert len(curves["storage"].points) == 10 and list(curves) == ["storage", "lattice"]
    assert "H of an unknown camera" in curves["lattice"].stopped
    took = {part: kept.took(subject_of(state, "psf"), part) for part in curves}
    assert took["storage"].startswith("measured in ") and not took["lattice"], "nothing was measured"


def used(state: ProjectState, part: str, **settings: Any) -> tuple[ProjectState, Any]:
    use = use_of(state, curve(part=part), point(0.1, 1.0, **settings))
    assert use.changes is not None, use.words
    return replace(state, **use.changes), use


def test_points_change_the_settings_that_pages_read() -> None:
    """The pages' own records read what a point wrote; what else was set stays."""
    state = replace(ProjectState(), plan=PLAN)
    state = replace(state, settings=ReconstructSettings(read_noise=3.0).into(state))
    state, use = used(state, "simulation", tolerance=0.06, level="wave", effects=["coma"])
    assert SimulateSettings.of(state) == SimulateSettings(tolerance=0.06) and use.page == "simulate"
    state, _ = used(state, "projection", method="sparse", double=True, threshold=0.01)
    state, _ = used(state, "solvers", solver="rl-tv", iterations=40)
    assert ReconstructSettings.of(state) == ReconstructSettings(
        "rl-tv", 40, read_noise=3.0, method="sparse", threshold=0.01, double=True
    )
    state, _ = used(state, "interpolation", interpolation="cubic")
    state, _ = used(state, "storage", dtype="rounded", compression="none")
    assert ExportSettings.of(state) == ExportSettings(suffix=".h5", dtype="rounded", uncompressed=True)
    assert FrameSettings.of(state).interpolation == "cubic"
    state, _ = used(state, "filters", route="spatial", filter="lanczos", pattern="Bayer")
    state, _ = used(state, "bases", mask="MURA", size=11, exposure_s=0.02)
    found = MultiplexSettings.of(state)
    assert (found.filter, found.family, found.mask, found.size) == ("lanczos", "mask", "MURA", 11)


def test_the_point_in_use_is_that_of_the_project() -> None:
    # settings of pages that are not installed may be of any type
    state = replace(ProjectState(), plan=PLAN, settings={"other": ["a"]})

    def used_of(part: str, *settings: dict[str, Any]) -> Any:
        found = in_use(state, curve(*(point(0.1, k + 1.0, **one) for k, one in enumerate(settings)), part=part))
        return None if found is None else found.settings

    coarse, usual = ({"tolerance": share, "level": "wave"} for share in (0.3, SimulateSettings().tolerance))
    assert used_of("simulation", coarse, usual) == usual, "by default"
    state, _ = used(state, "simulation", **coarse)
    assert used_of("simulation", coarse, usual) == coarse
    scans = [{"frames_averaged": n, "exposure_s": list(PLAN.exposures)} for n in (1, 4)]
    assert used_of("averaging", *scans) == used_of("recording", *scans, {"fitted_patterns": 24}) == scans[0]
    state, _ = used(state, "recording", **scans[1])
    assert used_of("averaging", *scans) == scans[1] and used_of("averaging", scans[0]) is None
    solvers = [{"solver": "rl-tv", "iterations": n} for n in (5, 10)]
    assert used_of("solvers", *solvers) is None
    state, _ = used(state, "solvers", **solvers[1])
    assert used_of("solvers", *solvers) == solvers[1]
    assert used_of("lattice", {"rows": 1}) is None
    sentence = words_of(curve(point(0.1, 1.0)), 0.2, running=False, in_use=point(0.3, 2.0))[0]
    assert sentence == "An error of 20 % costs 1.0 s: point 1 (10 %)\nIn use: point 2 (30 % for 2.0 s)"


def test_points_change_the_plan_or_say_why_not() -> None:
    state = replace(ProjectState(), plan=PLAN)
    changed, use = used(state, "averaging", frames_averaged=4, exposure_s=[0.005] * 3)
    assert changed.plan == replace(PLAN, frames_averaged=4, exposure_s=(0.005,) * 3)
    assert use.words == "Plan: 4 frames averaged, exposure 5 ms."
    low, high = min(PLAN.depths_um), max(PLAN.depths_um)
    changed, _ = used(state, "planes", depths_um=list(np.linspace(low, high, 5)))
    assert changed.plan.shape == (5, *PLAN.shape[1:])
    state = replace(ProjectState(), plan=PLAN)
    for name in ("bases", "averaging", "filters", "storage"):
        found = measure_curve(PARTS.get(name), Subject("small", PLAN, workers=1), 1.0)
        use = use_of(state, found, found.points[0])
        assert (use.changes is None) == (name == "storage" and found.points[0].settings["dtype"] == "uint8"), use.words


def test_a_point_that_cannot_be_used_says_so() -> None:
    state, planned = ProjectState(), replace(ProjectState(), plan=PLAN)
    for dtype, compression in (("float64", "gzip"), ("float16", "gzip"), ("rounded", "zstd")):
        words = refusal(state, "storage", dtype=dtype, compression=compression)
        assert words.startswith("the window exports H rounded or"), dtype
    for part in NO_USE:
        assert refusal(planned, part, dtype="uint8"), part
    for part in ("planes", "averaging"):
        assert refusal(state, part) == "there is no scan plan."
    assert refusal(state, "mine") == "the window has no setting for this part."
    for wrong in ({}, {"solver": "rl", "iterations": None}):
        assert refusal(state, "solvers", **wrong)


def test_the_command_names_the_order_of_axes_that_was_stated() -> None:
    project = ProjectState(psf="H.mat", settings={"accuracy": AccuracySettings(subject="psf").to_dict()})
    assert "mat" not in " ".join(step(project).arguments[2:])
    project = replace(project, settings=OpeningSettings().with_order("H.mat", "rows-first").into(project))
    made = step(project)
    assert "--mat-order=rows-first" in made.arguments and "open_psf('H.mat', mat_order='rows-first')" in made.python


def refusal(state: ProjectState, part: str, **settings: Any) -> str:
    """Return why a point of a part cannot be used."""
    use = use_of(state, curve(part=part), point(0.1, 1.0, **settings))
    assert use.changes is None
    return use.words.removeprefix("Nothing was changed: ")


def test_what_can_be_measured_and_settings_that_cannot_be(tmp_path: Path) -> None:
    assert subjects(ProjectState()) == ()
    save(PSFMatrix(np.ones((1, 2, 2, 3, 3), np.float32)), tmp_path / "H.h5")
    both = replace(ProjectState(), plan=PLAN, psf=str(tmp_path / "H.h5"))
    assert subjects(both) == ("plan", "psf")
    assert subjects(replace(both, psf=str(tmp_path / "gone.h5"))) == ("plan",)
    for change in ({"error": 0.0}, {"seconds": 0.0}, {"subject": "moon"}, {"seconds": float("nan")}):
        with pytest.raises(InputError):
            replace(AccuracySettings(), **change)
