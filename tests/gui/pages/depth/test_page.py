"""Use > Depth: a frame is opened, forecast, measured, looked at and saved; what is missing is said in one message."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor, preset
from lfcal.lattice import DepthMap
from lfcal.tasks import MeasuredDepth
from lfcal_gui.context import Context
from lfcal_gui.models import Tint
from lfcal_gui.pages.depth.model import DepthSettings
from tests.gui.conftest import OpenPage
from tests.gui.waiting import idle
from tests.lattice.fourier_scenes import SURFACES, camera_of, instrument, scene
from tests.lattice.plenoptic_scenes import draw, step

SHAPE, OFFSET = (170, 190), (0.3, -0.2)
SLOPES = (2.5, 4.0)


def make_camera() -> Camera:
    lattice = LensletLattice(
        "hexagonal", 110.0, 400.0, (LensType.focused_at(3.0, 400.0),), 0.02, (5 * OFFSET[1], 5 * OFFSET[0])
    )
    return Camera("one", MainLens(), lattice, Sensor(SHAPE, 5.0))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a frame of two planes that meet in the middle, its white image, and a part of the frame."""
    folder = tmp_path_factory.mktemp("depth")
    drawn = draw(SHAPE, 22.0, step(*SLOPES), rotation=0.02, noise=0.01, offset=OFFSET)
    frame = np.clip(np.rint(drawn.frame), 0, 65535).astype(np.uint16)
    tifffile.imwrite(folder / "frame.tif", frame)
    tifffile.imwrite(folder / "white.tif", np.rint(drawn.white).astype(np.uint16))
    tifffile.imwrite(folder / "part.tif", frame[10:150, 20:180])
    return folder


@pytest.fixture
def opened(open_page: OpenPage, context: Context, files: Path, qtbot: QtBot) -> Callable[..., Any]:
    """Return a function that opens a frame on the page, with a camera."""

    def made(name: str = "frame.tif", camera: Camera | None = None, **settings: Any) -> Any:
        state = context.state
        chosen = DepthSettings(**settings)
        context.project.update("set up", camera=camera or make_camera(), settings=chosen.into(state))
        page = open_page("depth")
        page.open_frame(str(files / name))
        idle(context.jobs, qtbot)
        return page

    return made


def test_a_frame_is_forecast_and_measured(opened: Callable[..., Any], context: Context, qtbot: QtBot) -> None:
    page = opened()
    panel = page.panel
    assert context.state.light_field.endswith("frame.tif") and "190 × 170 px" in panel.file.text()
    assert "of processor time" in panel.status.text() and panel.took.text().startswith(("about", "less than"))
    assert context.reported["depth"]["depth_s"] > 0
    assert panel.go.isEnabled() and not panel.save_map.isEnabled() and not panel.least.isEnabled()
    assert panel.view.shot.caption == "Light-field frame"
    qtbot.keyClick(page, Qt.Key.Key_F5)
    assert panel.go.text() == "Stop" and not panel.form.isEnabled()
    idle(context.jobs, qtbot)
    assert panel.took.text().startswith("done in") and panel.go.text() == "Measure"
    shot = panel.view.shot
    assert shot.tint is not None and shot.caption == "Depth over the central view"
    assert all(end.endswith("mm") for end in shot.tint.ends)
    page.panel.quantity.setCurrentIndex(panel.quantity.findData("slope"))
    idle(context.jobs, qtbot)
    shot = panel.view.shot
    assert isinstance(shot.tint, Tint) and [float(end) for end in shot.tint.ends] == pytest.approx(SLOPES, rel=0.05)
    columns = np.flatnonzero(np.isfinite(shot.tint.values[10]))
    assert shot.tint.values[10, columns[2]] < 0.1 and shot.tint.values[10, columns[-3]] > 0.9
    assert "median" in panel.facts.text() and "of camera one" in panel.facts.text()
    qtbot.keyClick(page, Qt.Key.Key_V)
    assert panel.view.shot.tint is None
    qtbot.keyClick(page, Qt.Key.Key_V)
    idle(context.jobs, qtbot)
    assert panel.view.shot.tint is not None


MISSING: dict[str, dict[str, Any]] = {
    "frame: expected the 170 rows and 190 columns of the sensor, got 140 rows and 160 columns": {"name": "part.tif"},
    "the 1200 rows and 1200 columns of the sensor, got 170 rows and 190 columns": {"camera": preset("flfm_20x05")},
    "expected a camera, a white image or a lattice file, got none": {"use_camera": False},
}


def measured(page: Any, context: Context, qtbot: QtBot) -> Any:
    page.start()
    idle(context.jobs, qtbot)
    return page.made.found


def test_a_map_is_computed_in_its_job_faded_read_and_saved_with_its_command(
    opened: Callable[..., Any], context: Context, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, waited = opened(), []

    def watched(compute: Callable[[Any], Any]) -> Callable[[Any], Any]:
        def computed(self: Any) -> Any:
            if threading.current_thread() is threading.main_thread():
                waited.append(compute)
            return compute(self)

        return computed

    with monkeypatch.context() as patch:
        patch.setattr(MeasuredDepth, "to_dict", watched(MeasuredDepth.to_dict))
        patch.setattr(DepthMap, "disparity_sigma", property(watched(vars(DepthMap)["disparity_sigma"].fget)))
        found, panel = measured(page, context, qtbot), page.panel
        assert "median" in panel.facts.text() and not waited
    for percent in (0, 90, 100):
        panel.least.setValue(percent)
        idle(context.jobs, qtbot)
        shown = np.isfinite(panel.view.shot.tint.values)
        np.testing.assert_array_equal(shown, found.known & (found.confidence >= percent / 100))
    known, unknown = np.argwhere(found.known)[50], np.argwhere(~found.known)
    for place, words in ((known, ("mm ±", "slope", "px", "confidence")), (unknown[0], ("unknown",))):
        panel.view.hovered.emit(*map(int, place), 1.0)
        assert all(word in panel.readout.text() for word in words)
    panel.view.hovered.emit(-1, -1, np.nan)
    assert panel.readout.text() == " "
    for kind, name in (("map", "a.tif"), ("points", "a.ply")):
        page.save(kind, str(tmp_path / name))
        idle(context.jobs, qtbot)
    assert tifffile.imread(tmp_path / "a.tif").shape == (5, *found.slope.shape)
    assert (tmp_path / "a.ply").read_bytes().startswith(b"ply")
    saved = [taken for taken in context.history.taken if taken.out]
    assert [Path(taken.out).name for taken in saved] == ["a.tif", "a.ply"]
    assert all(taken.step.arguments[0] == "depth" for taken in saved)
    page.start()
    context.project.start(replace(context.state, light_field=""))
    idle(context.jobs, qtbot)
    assert page.made is None and page.empty is not None and not panel.save_map.isEnabled(), "of another project"


def test_what_is_missing_is_one_message(opened: Callable[..., Any], context: Context, qtbot: QtBot) -> None:
    for words, given in MISSING.items():
        page = opened(**given)
        said = page.panel.status.text().replace("\xa0", " ")
        assert words in said and said.count(";") == 1 and "--" not in said
        assert page.panel.status.property("role") == "error" and not page.panel.go.isEnabled()
    page = opened()
    context.edit(page.settings, "slopes", "1.5,9")  # a forecast begins, which does not hide a refusal
    context.edit(page.settings, "use_camera", False)
    idle(context.jobs, qtbot)
    assert "got none" in page.panel.status.text() and not page.panel.go.isEnabled()


def test_a_fourier_microscope(opened: Callable[..., Any], files: Path, context: Context, qtbot: QtBot) -> None:
    at = instrument()
    tifffile.imwrite(files / "fourier.tif", scene(at, SURFACES["plane"]).astype(np.float32))
    page = opened("fourier.tif", camera_of(at), options=(("slopes", (-0.03, 0.01)),))
    assert "of processor time" in page.panel.status.text() and page.panel.go.isEnabled(), page.panel.status.text()
    page.start()
    idle(context.jobs, qtbot)
    assert page.made.to_dict()["depths"][1] == pytest.approx(12, abs=0.3)
    assert "median 1" in page.panel.facts.text() and "µm" in page.panel.facts.text()
    assert page.panel.view.shot.caption == "Depth over the central view"


def test_a_white_image_gives_slopes(opened: Callable[..., Any], files: Path, context: Context, qtbot: QtBot) -> None:
    page = opened(use_camera=False)
    editor = page.panel.form.editor("white")
    editor.setText(str(files / "white.tif"))
    editor.editingFinished.emit()
    idle(context.jobs, qtbot)
    assert page.panel.go.isEnabled() and page.panel.status.property("role") != "error"
    measured(page, context, qtbot)
    assert "Slope" in page.panel.facts.text() and page.panel.quantity.findData("depth") < 0
    assert page.panel.view.shot.caption == "Slope over the central view"
