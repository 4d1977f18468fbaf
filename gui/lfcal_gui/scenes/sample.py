"""The sample session: every page and tab with content."""

from __future__ import annotations

from collections.abc import Iterator

from lfcal.accuracy import PLACES
from lfcal.base import sample_session
from lfcal_gui.scenes.stage import Capture, Stage


def sample(stage: Stage) -> Iterator[Capture]:
    """Go through all pages with the sample session."""
    open_sample(stage)
    for scene in (setup, frames, h, simulate, checks, fit, reconstruct, multiplex, accuracy, sessions):
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
    """Show what accuracy costs, an effect and a frame; then compare H with the simulation."""
    page = stage.page("simulate")
    page.measure()
    stage.done()
    stage.tidy()
    yield Capture("simulate")
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


def sessions(stage: Stage) -> Iterator[Capture]:
    """Show the gallery of what was made, two H compared, and three reports over time."""
    reports, judged = stage.folder / "reports", stage.window.page("h")
    for day in ("2026-03-02", "2026-03-09", "2026-03-16"):
        if not (reports / day).is_dir():
            judged.checking.write_report(str(reports / day))  # type: ignore[attr-defined]
            stage.done()
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
    """Show the choices of a fit, and what it found."""
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
    """Show what accuracy costs."""
    page = stage.page("accuracy")
    for name in PLACES.names():
        page.measure((name,))
        stage.settle()
        page.context.edit(page.settings, "place", name)
        stage.settle()
        stage.tidy()
        yield Capture(f"accuracy_{name}")
