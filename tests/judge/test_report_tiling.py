"""Control frames on their way from a session to the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.recording.records import Kind
from lfcal.acquire.recording.source import CheckFrame
from lfcal.base.errors import InputError
from lfcal.frames.source import Position
from lfcal.judge.quality import inspect
from lfcal.judge.quality._units import control_frames
from lfcal.judge.report import report
from lfcal.psf import PSFMatrix

ANCHOR = (40.0, 52.0)


@pytest.fixture(scope="module")
def H() -> PSFMatrix:
    """Patterns that repeat every 4 x 6 pixels of the sensor."""
    rows, columns = np.mgrid[:21, :23]
    values = np.empty((2, 4, 6, 21, 23), np.float32)
    for z, y, x in np.ndindex(values.shape[:3]):
        lattice = (np.cos(np.pi / 2 * (rows + y)) + 1) * (np.cos(np.pi / 3 * (columns + x)) + 1)
        values[z, y, x] = lattice * np.exp(-((rows - 10) ** 2 + (columns - 11) ** 2) / (20 + 10 * z))
    return PSFMatrix(values, anchor=ANCHOR)


def checks(H: PSFMatrix, *periods: tuple[int, int]) -> list[CheckFrame]:
    """Return control frames of position (1, 2), three pixels wider than the cutout on each side."""
    return [
        CheckFrame(Kind.CONTROL, Position(z, 1, 2), away, 0.0, 1.0, (0, 0), np.pad(H[z, 1, 2], 3))
        for z in range(2)
        for away in periods
    ]


def test_control_frames_are_cut_out_like_H_and_placed(H: PSFMatrix, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfcal.judge.quality._units.read_checks", lambda _: checks(H, (1, 0), (0, -2)))
    found = control_frames(Path("session"), H)
    assert sorted(found) == [0, 1]
    frames, places = found[1]
    assert np.array_equal(frames, [H[1, 1, 2]] * 2)
    assert np.array_equal(places, [(40 + 1 + 4, 52 + 2), (40 + 1, 52 + 2 - 12)])
    quality = inspect(H, controls=found)
    assert quality["tiling"].value == pytest.approx(0, abs=1e-3)
    assert quality.tilings[0] is not None and quality.tilings[0].away.tolist() == [[1, 0], [0, -2]]


def test_sessions_without_control_frames_or_of_another_H_are_refused(
    H: PSFMatrix, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfcal.judge.quality._units.read_checks", lambda _: [])
    with pytest.raises(InputError, match="control frames"):
        control_frames(Path("session"), H)
    small = [check._replace(frame=np.zeros((5, 5))) for check in checks(H, (1, 0))]
    monkeypatch.setattr("lfcal.judge.quality._units.read_checks", lambda _: small)
    with pytest.raises(InputError, match="session in which H was recorded"):
        control_frames(Path("session"), H)


@pytest.mark.long
def test_the_page_shows_the_tiling_where_it_was_measured(H: PSFMatrix, tmp_path: Path) -> None:
    frames, places = np.asarray(H[0, 1:2, 2]), np.array([[45.0, 54.0]])
    page = report(H, tmp_path / "with", controls={0: (frames, places)})
    assert "Tiling over the field</h2>" in page.read_text() and (tmp_path / "with" / "tiling.png").exists()
    assert "Tiling over the field</h2>" not in report(H, tmp_path / "without").read_text()
