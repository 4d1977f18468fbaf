"""H assembled as it is from flipped or turned frames: the first line of its report says so."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.frames import ArraySource
from lfcal.judge.quality import QualityReport, inspect
from lfcal.psf import AssemblySettings, assemble_plan
from tests.frames.test_orientation import NUMPY
from tests.psf.test_orientation import UNDONE, a_plan, upright

# the cell in the middle of a square frame: nothing but the motion tells
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
    # its consequences are not told as faults of the stage
    for key in ("stage_gain", "drift", "jitter", "misplaced"):
        assert report[key].merit == "unknown"


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("gain", [0.0, 0.9, 1.15], ids=["standing still", "short steps", "long steps"])
def test_wrong_steps_are_not_taken_for_turned_frames(gain: float) -> None:
    assert "mirrored" not in of_frames("as is", gain * np.eye(2))["scan_order"].detail
    assert "turned" not in of_frames("as is", np.diag([1.0, gain]))["scan_order"].detail
