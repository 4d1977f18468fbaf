"""The sample session: every page and tab with content."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lfcal.accuracy import PARTS
from lfcal.base import cv2, write_tiff
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor
from lfcal.lattice import lattice_of
from lfcal.simulate import sample_session
from lfcal_gui.scenes.stage import Capture, Stage


def sample(stage: Stage) -> Iterator[Capture]:
    """Yield the states of all pages with the sample session."""
    open_sample(stage)
    for scene in (setup, frames, h, simulate, checks, fit, reconstruct, depth, multiplex, accuracy, watch, sessions):
        yield from scene(stage)


def open_sample(stage: Stage) -> None:
    """Open the sample session, unless the project has its frames and H already."""
    state = stage.window.project.state
    if not (state.frames and state.psf):
        stage.window.tools.sample()
        stage.done()


def setup(stage: Stage) -> Iterator[Capture]:
    """Show the scan over the lattice, the other views, all values, and a white image."""
    page = stage.page("setup")
    stage.tidy()
    yield Capture("setup")
    for button in page.panel.segments[1:]:
        button.click()
        stage.turn()
        yield Capture(f"setup_{button.text().lower()}")
    page.panel.segments[0].click()
    page.panel.inspector.values.open()
    stage.turn()
    yield Capture("setup_values")
    page.panel.inspector.values.head.setChecked(False)
    white = next((sample_session() / "white").glob("*.png"))
    page.check_white(str(white))
    stage.settle()
    stage.tidy()
    yield Capture("setup_white")
    page.check.show()
    stage.settle()
    yield Capture("setup_check", page.check)
    page.check.close()


def frames(stage: Stage) -> Iterator[Capture]:
    """Show a frame whole, and followed with its lattice."""
    page = stage.page("frames")
    stage.tidy()
    yield Capture("frames")
    page.panel.lattice_box.setChecked(True)
    page.panel.follow.setChecked(True)
    stage.settle()
    yield Capture("frames_follow")
    page.panel.follow.setChecked(False)
    page.panel.view.show_all()


def h(stage: Stage) -> Iterator[Capture]:
    """Show H, HT, and a logarithmic scale."""
    page = stage.page("h")
    stage.settle()
    stage.tidy()
    yield Capture("h")
    page.set_intent(transposed=True, pixel=(20, 20))
    page.panel.toggle_scale("log")
    stage.settle()
    yield Capture("h_transposed")
    page.set_intent(transposed=False)
    page.panel.toggle_scale("log")


def simulate(stage: Stage) -> Iterator[Capture]:
    """Show error against cost, measurements, an effect and a frame; then compare H with the simulation."""
    page = stage.page("simulate")
    page.measure()
    stage.done()
    stage.tidy()
    yield Capture("simulate")
    page.measure_effects()
    stage.done()
    yield Capture("simulate_measure", page.dialog)
    page.dialog.close()
    page.panel.table.select("vignetting")
    stage.settle()
    yield Capture("simulate_effect")
    page.make_frame()
    stage.settle()
    yield Capture("simulate_frame")
    simulated = stage.folder / "simulated.h5"
    if simulated.is_file():
        stage.window.project.update("reference", reference=str(simulated))
    else:
        page.simulate(str(simulated))
    stage.done()
    judge = stage.page("h")
    judge.set_intent(view="difference")
    stage.settle()
    stage.tidy()
    yield Capture("h_difference")
    judge.set_intent(view="both")


def checks(stage: Stage) -> Iterator[Capture]:
    """Show the checks of H, and the comparison with another H."""
    page = stage.page("h")
    page.look_into("checks")
    stage.done()
    stage.tidy()
    yield Capture("h_checks")
    page.checking.view.table.choose(4)
    stage.settle()
    yield Capture("h_checks_metric")
    page.look_into("compare")
    page.comparing.compare()
    page.set_intent(view="difference")
    stage.done()
    stage.tidy()
    yield Capture("h_compare")
    page.set_intent(view="both")
    page.look_into("")


def _date(report: Path, day: str) -> None:
    """Give a report the date of another inspection."""
    path = report / "quality.json"
    found = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(found | {"inspected": f"{day}T10:00:00+00:00"}), encoding="utf-8")


def watch(stage: Stage) -> Iterator[Capture]:
    """Show the page that checks H with ordinary frames."""
    stage.page("watch")
    stage.settle()
    yield Capture("watch")


def sessions(stage: Stage) -> Iterator[Capture]:
    """Show the gallery of results, the comparison of two H, and three reports over time."""
    reports, judged = stage.folder / "reports", stage.window.page("h")
    for day in ("2026-03-02", "2026-03-09", "2026-03-16"):
        if not (reports / day).is_dir():
            judged.checking.write_report(str(reports / day))  # type: ignore[attr-defined]
            stage.done()
            _date(reports / day, day)
    page = stage.page("sessions")
    page.choose(str(stage.folder))
    stage.settle()
    stage.tidy()
    yield Capture("sessions")
    page.panel.setCurrentWidget(page.panel.trend)
    stage.settle()
    page.panel.trend.table.setCurrentCell(2, 0)
    stage.tidy()
    yield Capture("sessions_over_time")
    page.panel.setCurrentIndex(0)


def fit(stage: Stage) -> Iterator[Capture]:
    """Show the settings and the result of a fit."""
    page = stage.page("h")
    page.look_into("fit")
    stage.tidy()
    yield Capture("h_fit_ready")
    page.fitting._edited("positions", 12)
    page.fitting.begin()
    stage.done()
    stage.tidy()
    yield Capture("h_fit")
    page.set_intent(view="both")
    page.look_into("")


def reconstruct(stage: Stage) -> Iterator[Capture]:
    """Show the place without a light field, with one, the volume in all views, and the settings."""
    page = stage.page("reconstruct")
    stage.tidy()
    yield Capture("reconstruct_empty")
    page.make_light_field("vesicle", str(stage.folder / "vesicle.tif"))
    stage.done()
    stage.tidy()
    yield Capture("reconstruct_light_field")
    page.context.edit(page.settings, "iterations", 15)
    stage.settle()
    page.start()
    stage.done()
    stage.tidy()
    yield Capture("reconstruct")
    view = page.panel.view
    for segment in view.segments[1:]:
        segment.click()
        stage.settle()
        yield Capture(f"reconstruct_{segment.text().lower()}")
    view.segments[0].click()
    page.panel.export.other.open()
    page.panel.more.open()
    stage.settle()
    yield Capture("reconstruct_folds")
    for fold in (page.panel.export.other, page.panel.more):
        fold.head.setChecked(False)


def drawn_scene(folder: Path) -> tuple[Camera, Path]:
    """Return a camera, and a frame of a ball over a slanted plane with a random texture, as its lenslets see it."""
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.5, 3.0, 4.0))
    lattice = LensletLattice("hexagonal", 120.0, 400.0, types, 0.01)
    camera, path = Camera("drawn scene", MainLens(), lattice, Sensor((720, 960), 5.0)), folder / "drawn.tif"
    rows, columns = np.indices(camera.sensor.shape).astype(float)
    seen = lattice_of(camera)
    pixel = np.stack([rows, columns], axis=-1)
    centre = seen.centres_px(*np.rint(seen.lenslet_at(rows, columns)).transpose(2, 0, 1))
    slope = np.full(rows.shape, 3.0)
    for _ in range(20):  # where the chief ray of a pixel meets the surface
        y, x = np.moveaxis(centre + slope[..., None] * (pixel - centre), -1, 0)
        ball = np.sqrt(np.clip(1 - ((y - 360) ** 2 + (x - 480) ** 2) / 240**2, 0, None))
        slope = 4.0 + (x - 480) / 1000 - 1.2 * ball
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(1024, 1024)).astype(np.float32), (0, 0), 5)
    light = cv2.remap(noise / noise.std(), x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    frame = np.where(np.hypot(*np.moveaxis(pixel - centre, -1, 0)) < 11.5, 1500 + 500 * light, 0)
    write_tiff(path, np.random.default_rng(1).poisson(np.clip(frame, 0, None)).astype(np.uint16))
    return camera, path


def depth(stage: Stage) -> Iterator[Capture]:
    """Show the depth map of a drawn light field, and its frame; then the sample's camera and light field again."""
    page, project = stage.page("depth"), stage.window.project
    stage.tidy()
    yield Capture("depth_frame")
    before = project.state
    camera, frame = drawn_scene(stage.folder)
    project.update("drawn scene", camera=camera, plan=None, light_field=str(frame))
    stage.settle()
    page.start()
    stage.done()
    stage.tidy()
    yield Capture("depth")
    page.panel.form.head.setChecked(True)
    stage.turn()
    yield Capture("depth_settings")
    page.panel.form.head.setChecked(False)
    project.update("sample", camera=before.camera, plan=before.plan, light_field=before.light_field)
    stage.settle()


def multiplex(stage: Stage) -> Iterator[Capture]:
    """Show the modulator and the reconstruction."""
    page = stage.page("multiplex")
    stage.tidy()
    yield Capture("multiplex")
    page.panel.tabs.setCurrentIndex(1)
    stage.settle()
    stage.tidy()
    yield Capture("multiplex_reconstruction")
    page.panel.tabs.setCurrentIndex(0)


def accuracy(stage: Stage) -> Iterator[Capture]:
    """Show the page Accuracy."""
    page = stage.page("accuracy")
    for name in PARTS.names():
        page.measure((name,))
        stage.settle()
        page.context.edit(page.settings, "part", name)
        stage.settle()
        stage.tidy()
        yield Capture(f"accuracy_{name}")
