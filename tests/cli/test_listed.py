"""What ``lfcal plan --positions`` and ``lfcal assemble`` say of lists and of frames that are not the camera's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lfcal.camera import Camera
from lfcal.tasks._scan_frames import note_size
from tests.cli.conftest import Run
from tests.frames.lists.scans import SENSOR, scan, small_camera, write_frames


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (
            (20, 24),
            "this suggests binning of 2 x 2. If the frames are binned, create a camera file with the binned pixels",
        ),
        ((24, 20), "this suggests binning of 2 x 2"),
        ((13, 16), "this suggests binning of 3 x 3"),
        ((10, 12), "this suggests binning of 4 x 4"),
        ((20, 40), "--frame FRAME"),
        ((38, 44), "--frame FRAME"),
    ],
)
def test_binned_frames_need_a_camera_of_larger_pixels(
    shape: tuple[int, int], words: str, caplog: pytest.LogCaptureFixture
) -> None:
    note_size(shape, small_camera())
    said = caplog.text
    assert words in said and ("--frame" in said) != ("--sensor" in said)


def test_what_is_said_of_binned_frames_makes_their_camera(
    lfcal: Callable[..., Run], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    camera = small_camera()
    (tmp_path / "camera.json").write_text(camera.to_json())
    note_size((SENSOR[0] // 2, SENSOR[1] // 2), camera)
    said = caplog.text
    words = said[said.index("camera import") : said.index("BINNED,")].split()
    names = {"CAMERA": tmp_path / "camera.json"}
    assert lfcal(*(names.get(word, word) for word in words), tmp_path / "binned.json").code == 0
    binned = Camera.from_json((tmp_path / "binned.json").read_text())
    assert binned.sensor.shape == (SENSOR[0] // 2, SENSOR[1] // 2)
    np.testing.assert_allclose(binned.period_px, np.array(camera.period_px) / 2, rtol=1e-4)
    assert binned.step_um(0.0) == pytest.approx(2 * camera.step_um(0.0), rel=1e-4)


def test_a_list_that_numbers_its_planes_and_one_of_a_wrong_z(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    found = scan()
    names = [f"shot{k:03d}.tif" for k in range(len(found.stage))]
    write_frames(tmp_path / "tiffs", found, names)
    (tmp_path / "camera.json").write_text(found.camera.to_json())

    def listed(name: str, header: str, last: np.ndarray) -> Path:
        rows = [f"{file},{x:.3f},{y:.3f},{z:g}" for file, (x, y, _), z in zip(names, found.stage, last, strict=True)]
        (tmp_path / name).write_text("\n".join([f"file,x_um,y_um,{header}", *rows]))
        return tmp_path / name

    def plan(path: Path) -> Run:
        named = ("--positions", path, "--frames", tmp_path / "tiffs", "--cutout", "9,11")
        return lfcal("plan", tmp_path / "camera.json", *named, "-o", tmp_path / f"{path.stem}.json")

    def assemble(path: Path) -> Run:
        named = ("--manifest", path, "-p", tmp_path / "numbered.json", "--black-level", "100")
        return lfcal("assemble", tmp_path / "tiffs", *named, "-o", tmp_path / f"{path.stem}.h5")

    numbered = listed("numbered.csv", "plane", found.positions[:, 0] + 1)
    done = plan(numbered)
    assert done.code == 0 and "z=plane (index)" in done.err, done.err
    assert assemble(numbered).code == 0
    longer = listed("longer.csv", "z_um", 1.8 * found.stage[:, 2])
    done = plan(longer)
    assert done.code == 0 and "its range is 1.8" in done.err and "z and the steps disagree" in done.err, done.err
    done = assemble(longer)
    assert done.code == 0 and "are 1.8" in done.err, done.err
    done = assemble(listed("thousand.csv", "z_um", found.stage[:, 2] / 1e3))
    assert done.code == 2 and "z of the planes: expected the spacing of the planned planes, got 0.001" in done.err
