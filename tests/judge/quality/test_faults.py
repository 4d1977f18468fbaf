"""Faults in recordings are named by their metric; clean recordings raise no alarm."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.frames import ArraySource
from lfcal.judge.quality import QualityReport, inspect
from lfcal.psf import AssemblySettings, assemble_plan
from tests.frames.test_orientation import NUMPY
from tests.psf.test_orientation import UNDONE, a_plan, upright

from .faults import CLEAN, FAULTS
from .scenes import Scene, hexagonal, single, square

SQUARE = ("two rows swapped", "axes swapped", "stage step 10 % too large", "planes in the wrong order", "a hot pixel")


def named(scene: Scene, name: str) -> list[str]:
    """Return the bad metrics of a fault, costliest first."""
    return [m.key for m in inspect(FAULTS[name].make(scene), workers=1).alarms]


@pytest.mark.few(1)
@pytest.mark.parametrize("scene", [hexagonal, square, single], ids=lambda s: s.__name__)
@pytest.mark.parametrize("kind", CLEAN)
def test_nothing_clean_raises_an_alarm(scene, kind):
    report = inspect(CLEAN[kind](scene()), workers=1)
    assert report.merit == "good", [(m.key, m.text) for m in report.metrics if m.merit in ("bad", "fair")]
    assert report.redo() == []


@pytest.mark.few(2)
@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_is_named_by_its_metric(name):
    alarms = named(hexagonal(), name)
    assert set(alarms[:2]) & set(FAULTS[name].names), alarms


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("name", SQUARE)
def test_a_square_array_is_judged_as_well(name):
    alarms = named(square(), name)
    assert set(alarms[:2]) & set(FAULTS[name].names), alarms


def test_single_frames_are_named_by_position_and_the_order_in_words():
    report = inspect(FAULTS["a missing frame"].make(hexagonal()))
    assert report.redo() == [((1, 4, 7), "missing frames")] and not np.isnan(report["missing"].map).any()
    report = inspect(FAULTS["direction reversed"].make(hexagonal()))
    assert "backwards along x" in report["scan_order"].detail


# -- H assembled from flipped or turned frames -----------------------------------------------------------
# the cell in the middle of a square frame: only the motion shows it
PLAN = a_plan((80, 80), (11, 15), (34.5, 32.5), 2, (41, 41))


def of_frames(name: str, moves: np.ndarray | None = None) -> QualityReport:
    """Return the report of an H made as is from frames that need ``name``."""
    frames, places = upright(PLAN, width=5.0, noise=4.0, moves=moves)
    delivered = np.stack([NUMPY[UNDONE.get(name, name)](frame) for frame in frames]) - 100
    return inspect(assemble_plan(ArraySource(delivered, places), PLAN, None, AssemblySettings(pad=True)).matrix)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("mirror x", "mirrored left to right"),
        ("mirror y", "mirrored top to bottom"),
        ("rot180", "turned by 180°"),
        ("rot90", "turned clockwise by 90°"),
        ("rot270", "turned anticlockwise by 90°"),
        ("transpose", "transposed (rows"),
        ("anti-transpose", "transposed and turned"),
    ],
)
def test_the_first_line_names_it(name: str, words: str) -> None:
    report = of_frames(name)
    first = report.metrics[0]
    assert first.key == "scan_order"
    assert first.value == 2
    assert words in first.detail
    assert words in report.verdict
    # its consequences are not reported as faults of the stage
    for key in ("stage_gain", "drift", "jitter", "misplaced"):
        assert report[key].merit == "unknown"


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("gain", [0.0, 0.9, 1.15], ids=["standing still", "short steps", "long steps"])
def test_wrong_steps_are_not_taken_for_turned_frames(gain: float) -> None:
    assert "mirrored" not in of_frames("as is", gain * np.eye(2))["scan_order"].detail
    assert "turned" not in of_frames("as is", np.diag([1.0, gain]))["scan_order"].detail
