"""A half-cell scan assembled as a whole one: its patterns in both places, marked, and counted once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.axes import Region
from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan
from lfcal.camera.plan import half_cell
from lfcal.fit import measured_of
from lfcal.frames.half_cell import with_partners
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, Noise, Position
from lfcal.judge.quality import inspect
from lfcal.psf import PSFMatrix, open_psf
from lfcal.psf.assembly import assemble_plan
from lfcal.psf.half_cell import copied_positions
from tests.camera.test_plan import camera_of, plan_of

PLAN: ScanPlan = plan_of(camera_of((6.0, 12.0), 1))
NY, NX = PLAN.period
HALF = half_cell(PLAN).half(PLAN)


class Drawn(Frames):
    """Frames of positions whose patterns repeat with the primitive cell; whole sensors, or cutouts with an origin."""

    def __init__(self, positions: NDArray[np.intp], *, cut: bool) -> None:
        self.positions, self.cut = positions, cut

    @property
    def shape(self) -> tuple[int, int]:
        return (35, 35) if self.cut else PLAN.camera.sensor.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(np.float32)

    @property
    def metadata(self) -> FrameMetadata:
        return FrameMetadata(noise=Noise(4.0, 1.0), saturation=1e4)

    def __len__(self) -> int:
        return len(self.positions)

    def _first(self, k: int) -> tuple[int, int]:
        row, column = PLAN.image_px(self.positions[k]).round().astype(int).tolist()
        return (row - 17, column - 17) if self.cut else (0, 0)

    def info(self, index: int) -> FrameInfo:
        at = Position(*self.positions[index].tolist())
        return FrameInfo((at,), self._first(index), 0.02, label=f"frame {index}")

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        z, y, x = self.positions[index].tolist()
        # (y, x) and (y + ny/2, x + nx/2) are one place of the primitive cell
        y, x = (y, x) if y < NY // 2 else (y - NY // 2, (x - NX // 2) % NX)
        image = np.zeros(PLAN.camera.sensor.shape, np.float32)
        row, column = PLAN.image_px(self.positions[index]).round().astype(int).tolist()
        pattern = np.random.default_rng(1 + (z * NY + y) * NX + x).random((31, 31))
        image[row - 15 : row + 16, column - 15 : column + 16] = pattern
        image[row - 5 : row + 6, column - 5 : column + 6] += 100 * pattern[:11, :11]
        top, left = self._first(index)
        frame = image[top : top + self.shape[0], left : left + self.shape[1]]
        return frame.copy() if region is None else frame[region].copy()


@pytest.mark.parametrize("cut", [False, True])
def test_half_the_frames_make_the_same_h(cut: bool) -> None:
    whole = assemble_plan(Drawn(PLAN.order_indices(), cut=cut), PLAN).matrix
    report = assemble_plan(with_partners(Drawn(HALF, cut=cut), PLAN), PLAN)
    matrix = report.matrix
    np.testing.assert_array_equal(matrix.plane(0), whole.plane(0))
    assert report.frames == NY * NX // 2 and not report.missing and matrix.provenance["frames"]["count"] == NY * NX // 2
    copied = copied_positions(matrix)
    assert not copied[:, : NY // 2].any() and copied[:, NY // 2 :].all()
    said = matrix.provenance["half_cell"]
    assert said["positions"] == [[NY * NX // 2, NY * NX]] and said["shift"] == [NY // 2, NX // 2]
    assert list(said) == ["frames", "filled", "shift", "residual_px", "positions"]
    assert not copied_positions(whole).any()


def test_positions_with_a_frame_of_their_own_keep_it() -> None:
    more = np.concatenate([HALF, [[0, NY - 1, 2]]])
    view = with_partners(Drawn(more, cut=True), PLAN)
    assert len(view) == 2 * len(HALF) and (NY - 1) * NX + 2 not in view.filled
    assert view.info(len(HALF)).label == f"frame {len(HALF)}" and " for (0, " in view.info(len(more)).label
    copied = copied_positions(assemble_plan(view, PLAN).matrix)
    assert copied.sum() == len(HALF) - 1 and not copied[0, NY - 1, 2]
    with pytest.raises(InputError, match="frames at all positions"):
        with_partners(Drawn(PLAN.order_indices(), cut=True), PLAN)
    with pytest.raises(InputError, match="half of which is not a whole number of pixels"):
        with_partners(Drawn(HALF, cut=True), plan_of(camera_of((7.0, 12.0), 1)))


@pytest.mark.long
def test_copies_are_no_further_measurements() -> None:
    """A fit takes what was recorded; no copy is a duplicate frame; a frame recorded twice still is."""
    matrix = assemble_plan(with_partners(Drawn(HALF, cut=True), PLAN), PLAN).matrix
    measured = measured_of(matrix)
    assert len(measured) == len(HALF) and (measured.index[:, 1] < NY // 2).all()

    def duplicates(of: PSFMatrix) -> float:
        (found,) = [m for m in inspect(of).metrics if m.spec.key == "duplicates"]
        return found.value

    assert duplicates(matrix) == 0
    whole = assemble_plan(Drawn(PLAN.order_indices(), cut=True), PLAN).matrix
    assert duplicates(whole) > 0, "without the mark they are"


def test_marks_in_the_file_are_kept_and_read_with_care(tmp_path: Path) -> None:
    assemble_plan(with_partners(Drawn(HALF, cut=True), PLAN), PLAN, tmp_path / "H.h5").matrix.close()
    with open_psf(tmp_path / "H.h5") as matrix:
        assert copied_positions(matrix).sum() == len(HALF)
    for said in (None, 3, {}, {"positions": 1}, {"positions": [[0]]}, {"positions": [[-1, 1e9]]}):
        matrix = PSFMatrix(np.zeros((1, 2, 2, 3, 3), np.float32), provenance={"half_cell": said})
        assert not copied_positions(matrix).any()
