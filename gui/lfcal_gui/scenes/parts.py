"""The empty window, figures and search of Multiplexing, an enlarged picture, a large H, and a target."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import cv2
from lfcal.camera import preset
from lfcal.frames import Position
from lfcal.psf import PSFMatrix, save
from lfcal_gui.models import ProjectState
from lfcal_gui.scenes.recording import settle_live
from lfcal_gui.scenes.sample import open_sample
from lfcal_gui.scenes.stage import Capture, Stage
from lfcal_gui.widgets import toggle_in


def parts(stage: Stage) -> Iterator[Capture]:
    """Yield the states of these parts with the sample session."""
    open_sample(stage)
    yield from _multiplexing(stage)
    yield from _pictures(stage)


def _multiplexing(stage: Stage) -> Iterator[Capture]:
    page = stage.page("multiplex")
    page.panel.tabs.setCurrentIndex(2)
    for figure, name in ((3, "3"), (5, "5"), (6, "6"), (7, "7"), (0, "map")):
        page._edited("figure", figure)
        stage.settle()
        stage.tidy()
        yield Capture(f"multiplex_figure_{name}")
    page.panel.tabs.setCurrentIndex(3)
    stage.settle()
    yield Capture("multiplex_search_empty")
    for sought in ("filters", "mask"):
        page._edited("sought", sought)
        page.searching.search()
        stage.done()
        stage.tidy()
        yield Capture(f"multiplex_search_{sought}")
    page.panel.tabs.setCurrentIndex(0)
    for family in ("mask", "both"):
        page._edited("family", family)
        page._edited("size", 5)
        stage.settle()
        stage.tidy()
        yield Capture(f"multiplex_{family}")
    page._edited("family", "cfa")


def _pictures(stage: Stage) -> Iterator[Capture]:
    page = stage.page("h")
    measuring = page.panel.main_view.measure()
    stage.turn(40)
    yield Capture("dialog_measuring", measuring)
    measuring.close()
    apertures = page.panel.show_apertures()
    stage.turn()
    yield Capture("dialog_apertures", apertures)
    apertures.close()
    for key in ("h", "frames"):
        page = stage.page(key)
        toggle_in(page)
        stage.settle()
        stage.tidy()
        yield Capture(f"{key}_enlarged")
        toggle_in(page)
        stage.turn()


def empty(stage: Stage) -> Iterator[Capture]:
    """Show the welcome and the empty pages."""
    window = stage.window
    welcome = window.tools.welcome()
    stage.turn()
    yield Capture("welcome", welcome)
    welcome.close()
    for spec in window.specs:
        stage.page(spec.key)
        stage.tidy()
        yield Capture(f"{spec.key}_empty")


NAME = "R29_main_lens_100mm_f2.8_2026-03-16_second_alignment_after_cleaning"
"""A long file name, as users choose them."""

PITCH, CUTOUT = 27.6, 181


def large(stage: Stage) -> Iterator[Capture]:
    """Show the scan and H of an R29, then one of its frames."""
    window = stage.window
    window.project.update("R29", camera=preset("r29"), plan=None, frames="", psf="", reference="")
    page = stage.page("setup")
    page.make_default()
    stage.tidy()
    yield Capture("setup_r29")
    saved = stage.folder / f"{NAME}.h5"
    if not saved.is_file():
        save(_matrix(), saved)
    window.project.update("open", psf=str(saved))
    stage.page("h")
    stage.tidy()
    yield Capture("h_r29")
    page = stage.page("frames")
    page.open_folder(str(_frames(stage.folder / NAME)))
    stage.settle()
    page.panel.lattice_box.setChecked(True)
    stage.settle()
    stage.tidy()
    yield Capture("frames_r29_missing")
    page.go_to(Position(0, 27, 47))
    stage.settle()
    yield Capture("frames_r29")
    page.panel.follow.setChecked(True)
    stage.settle()
    yield Capture("frames_r29_follow")
    page.panel.follow.setChecked(False)


def _matrix() -> PSFMatrix:
    """Return two planes that resemble H of such a camera, as blurred discs behind a hexagonal array."""
    ny, nx = 11, 19  # a fifth of the positions of the period: all take minutes to write and to judge
    planes = []
    for radius in (70.0, 45.0):
        row = np.stack([_pattern(5 * x, radius) for x in range(nx)])
        planes.append(np.broadcast_to(row, (ny, *row.shape)))
    return PSFMatrix(np.stack(planes))


def _pattern(x: float, radius: float) -> NDArray[np.float32]:
    t, s = np.mgrid[:CUTOUT, :CUTOUT] - CUTOUT // 2
    light = np.zeros((CUTOUT, CUTOUT), np.float32)
    for k in range(-4, 5):
        for j in range(-4, 5):
            row, column = k * PITCH * np.sqrt(0.75), (j + k % 2 / 2) * PITCH - x % PITCH
            if row**2 + column**2 < radius**2:
                light += np.exp(-((t - 0.9 * row) ** 2 + (s - 0.9 * column) ** 2) / 18)
    return 1000 * light


def _frames(folder: Path) -> Path:
    """Write three frames of 29 megapixels with their list; return the folder."""
    if (folder / "manifest.csv").is_file():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    frame = rng.integers(90, 110, (4384, 6576), np.uint16)
    at = 2192 - CUTOUT // 2, 3288 - CUTOUT // 2
    frame[at[0] : at[0] + CUTOUT, at[1] : at[1] + CUTOUT] += _pattern(0.0, 70.0).astype(np.uint16)
    rows = ["file,z,y,x"]
    for x in (46, 47, 48):
        cv2.imwrite(str(folder / f"z0_y27_x{x}.tif"), np.roll(frame, x - 47, axis=1))
        rows.append(f"z0_y27_x{x}.tif,0,27,{x}")
    (folder / "manifest.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


def target(stage: Stage) -> Iterator[Capture]:
    """Plan a target for the bench camera, and record it."""
    stage.window.files.start_with(ProjectState(camera=preset("bench")))
    page = stage.page("setup")
    page.make_default()
    page.target.show()
    stage.tidy()
    yield Capture("plan_point", page.target)
    _type(page, "source", "array")
    _planned(stage, page)
    yield Capture("plan_target", page.target)
    _type(page, "most_frames", "30")
    _planned(stage, page)
    yield Capture("plan_target_part", page.target)
    yield from _recorded(stage, page)
    page = stage.page("setup")
    _type(page, "source", "array:4x4@1mm")
    _planned(stage, page)
    yield Capture("plan_target_refused", page.target)


def _recorded(stage: Stage, plan: Any) -> Iterator[Capture]:
    """Record the target that was planned, with the simulator."""
    _type(plan, "pose", "rotation=0.2")
    _type(plan, "regions", "1x3")
    _planned(stage, plan)
    yield Capture("plan_target_pose", plan.target)
    file = stage.folder / "target_plan.json"
    file.write_text(plan.target.found.plan.to_json(), encoding="utf-8")
    page = stage.page("acquire")
    page.panel.setCurrentWidget(page.panel.record)
    page.record.target.take(str(file))
    stage.settle()
    folder = stage.folder / "target_session"
    rmtree(folder, ignore_errors=True)
    page.record.folder_choice.take(str(folder))
    stage.settle()
    stage.tidy()
    yield Capture("acquire_target_ready")
    page.record.start()
    stage.until(lambda: page.record.recording, "the recording to begin")
    stage.until(lambda: not page.record.recording, "the recording to end")
    settle_live(stage, page)
    stage.tidy()
    yield Capture("acquire_target_complete")


def _type(page: Any, key: str, text: str) -> None:
    editor = page.target.form.editor(key)
    editor.setText(text)
    editor.textEdited.emit(text)


def _planned(stage: Stage, page: Any) -> None:
    page.target.plan_target()
    stage.settle()
    stage.tidy()
