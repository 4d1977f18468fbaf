"""What could hold the window: modules that are loaded, widgets that are made, garbage; and the benchmarks of it."""

from __future__ import annotations

import gc
import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from PySide6 import QtWidgets as qt
from pytestqt.qtbot import QtBot

from benchmarks.__main__ import command_line
from benchmarks._window_layout import controls, hovering, layout
from benchmarks.window import MEASURED, WORDS, live_frames, scrubbing
from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal_gui import _ahead as ahead_module
from lfcal_gui import _background as background
from lfcal_gui import _garbage as garbage
from lfcal_gui._ahead import Ahead
from lfcal_gui._garbage import CALM_TICKS, LATEST_TICKS, Collector
from lfcal_gui.jobs import Jobs
from lfcal_gui.pages.acquire._pictures import ErrorView, RecordPictures
from lfcal_gui.pages.acquire.panel import AcquirePanel
from lfcal_gui.pages.acquire.setup_panel import SetupPanel
from lfcal_gui.pages.h.panel import HPanel, LevelRow
from lfcal_gui.screenshots import main as take_pictures
from lfcal_gui.window import MainWindow
from tests.gui.waiting import idle


def printed_by(code: str, folder: Path) -> Any:
    """Run code in its own process and return the JSON of its last line."""
    command = [sys.executable, "-c", code.replace("FOLDER", repr(str(folder)))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


VISITS = """
import json, sys, threading
from pathlib import Path
heavy, loaded = ("scipy", "matplotlib", "numba", "tifffile", "cv2", "rawpy"), []

def hook(event, arguments):
    if event == "import" and threading.current_thread() is threading.main_thread():
        name = arguments[0].partition(".")[0]
        if name in heavy and name not in loaded:
            loaded.append(name)

sys.addaudithook(hook)
from benchmarks._window_holds import visit_all
visit_all(Path(FOLDER))
print(json.dumps(loaded))
"""


def test_no_page_loads_the_libraries_of_its_work(tmp_path: Path) -> None:
    """Scipy and matplotlib took half a second of the first look at a page."""
    assert printed_by(VISITS, tmp_path) == []


STARTED = """
import json, sys, time
from pathlib import Path
from PySide6.QtWidgets import QApplication
from lfcal_gui.app import begin, make_window, parse

options, app = parse([]), QApplication([])
window = make_window(app, options, folder=Path(FOLDER))
window.show()
begin(window, options)
app.processEvents()
loaded = set(sys.modules)
window.import_pages()
while "lfcal_gui.pages.sessions.page" not in sys.modules or window.jobs.loading("pages"):
    app.processEvents()
    time.sleep(0.01)
print(json.dumps([sorted(loaded), sorted(set(sys.modules) - loaded)]))
window.shut_down()
"""


def test_the_first_window_loads_neither_libraries_nor_later_pages(tmp_path: Path) -> None:
    """Lattice, image formats, H and two dialogs took a third of the start."""
    loaded, later = printed_by(STARTED, tmp_path)
    libraries = {"scipy", "matplotlib", "numba", "tifffile", "cv2", "rawpy", "h5py", "yaml"}
    assert not libraries & set(loaded)
    parts = ("lfcal.lattice.", "lfcal.frames.", "lfcal.psf.", "lfcal.simulate.", "lfcal_gui.pages.setup._check_dialog")
    assert not [name for name in loaded if name.startswith(parts)]
    pages = {name.split(".")[2] for name in loaded if name.startswith("lfcal_gui.pages.") and name.count(".") > 2}
    assert pages == {"setup"}
    dialogs = {f"lfcal_gui.pages.setup._{name}_dialog" for name in ("check", "sensor", "target")}
    assert dialogs | {"lfcal.camera.importers.olaf_yaml", "lfcal.accuracy.parts.solvers"} <= set(later)


def test_pictures_are_made_when_they_are_first_shown(qtbot: QtBot, jobs: Jobs) -> None:
    h, acquire = HPanel(), AcquirePanel(SetupPanel(jobs))
    for panel in (h, acquire):
        qtbot.addWidget(panel)
    h.show_fit(None)
    h.apply_theme()
    assert h.pictures.count() == 1 and h.levels.count() == 1 and len(h.findChildren(LevelRow)) == 3
    assert h.fitted is h.fitted and h.pictures.count() == 2
    acquire.show()
    acquire.record.show_error(None)
    acquire.apply_theme()
    assert not acquire.record.findChildren(RecordPictures)
    acquire.setCurrentWidget(acquire.record)
    assert acquire.record.findChildren(RecordPictures) == [acquire.record.pictures]
    assert acquire.record.pictures.isVisible() and not acquire.record.pictures.findChildren(ErrorView)


def test_pages_are_made_in_short_steps_while_nothing_happens(
    qapp: qt.QApplication, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first look at a page took up to 140 ms."""
    clock, pages, busy = Clock(), dict[str, int](), [False]
    monkeypatch.setattr(ahead_module, "time", clock)
    owner = qt.QWidget()

    def make(key: str) -> bool:
        pages[key] = pages.get(key, 0) + 1
        return pages[key] <= 2

    ahead = Ahead(("a", "b"), make, lambda: busy[0], owner)
    ahead.start()
    for held in (True, False):
        busy[0], clock.now_s = held, clock.now_s + 1.0  # the user works, and a job runs
        ahead.step()
        assert not pages
    busy[0] = True
    ahead.step()
    assert not pages, "the result of a job will be shown soon"
    busy[0] = False
    found = []
    for _ in range(4):
        ahead.step()
        found.append(dict(pages))
    assert found == [{"a": 1}, {"a": 2}, {"a": 3, "b": 1}, {"a": 3, "b": 2}]
    assert ahead.active
    ahead.step()
    assert not ahead.active


def test_calls_of_one_turn_end_when_its_time_is_used(jobs: Jobs, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, called = Clock(), list[str]()
    monkeypatch.setattr(background, "time", clock)

    def work(name: str, s: float) -> None:
        called.append(name)
        clock.now_s += s

    for name in "abcd":
        jobs.later(partial(work, name, 0.6 * background.TURN_S))
    turns = []
    while jobs.busy:
        jobs._take()
        turns.append("".join(called))
    assert turns == ["ab", "abcd"]


def test_a_result_waits_for_the_calls_that_were_left_before_it(jobs: Jobs, qtbot: QtBot) -> None:
    """A page would show a result for another state of the project than its own."""
    called = list[str]()
    jobs.compute("a", lambda: "result", called.append)
    jobs.later(lambda: called.append("page"))
    idle(jobs, qtbot)
    assert called == ["page", "result"]


def test_only_the_current_page_follows_a_change_in_the_same_turn(window: MainWindow, qtbot: QtBot) -> None:
    """A first plan held the window for 100 ms, in which hidden pages and other windows were updated."""
    followed = list[tuple[str, str, str]]()
    for spec in window.specs:
        page: Any = window.page(spec.key)
        page.state_changed = lambda old, new, key=spec.key: followed.append((key, old.name, new.name))
    window.go("frames")
    idle(window.jobs, qtbot)
    first, other = window.project.state.name, {spec.key for spec in window.specs} - {"frames"}
    window.project.update("name", name="one")
    assert followed == [("frames", first, "one")]
    window.page("h")
    assert followed[1:] == [("h", first, "one")], "a page is up to date whenever it is used"
    window.project.update("name", name="two")
    idle(window.jobs, qtbot)
    late = {key: (old, new) for key, old, new in followed[3:]}
    assert followed[2] == ("frames", "one", "two") and set(late) == other and len(followed) == 3 + len(other)
    assert late.pop("h") == ("one", "two") and set(late.values()) == {(first, "two")}


def test_a_page_that_the_user_chooses_is_made_in_turns(window: MainWindow, qtbot: QtBot) -> None:
    """The first look at a page took 60 to 100 ms immediately after the start."""
    shown, left = window.stack.currentWidget(), list[Callable[[], None]]()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(window.jobs, "later", left.append)
        window.visit("reconstruct")
        turns = 0
        while left:
            assert window.stack.currentWidget() is shown, "no half of a page is shown"
            left.pop(0)()
            turns += 1
        assert turns == 5 and window.stack.currentWidget() is window.page("reconstruct")
        window.visit("h")
        window.visit("simulate")
    while left:
        left.pop(0)()
    idle(window.jobs, qtbot)
    assert window.shown is window.page("simulate"), "the last choice counts"
    window.visit("acquire")
    window.go_view(1)
    idle(window.jobs, qtbot)
    assert window.shown.spec is window.views("record")[1], "a key applies to the page that was chosen before"
    window.visit("h")
    assert window.page("h").styleSheet(), "a page that is used is complete"


def test_a_page_follows_before_the_user_works_on_it(window: MainWindow) -> None:
    window.go("h")
    page: Any = window.page("setup")
    window.project.update("camera", camera=preset("r29"))
    window.go("setup")
    assert page.panel.inspector.values.editor("sensor.rows").text() == str(preset("r29").sensor.shape[0])


def test_a_page_has_one_style_sheet(window: MainWindow) -> None:
    """A style sheet inside another one is applied twice to everything in it."""
    for spec in window.specs:
        page = window.page(spec.key)
        parts = page.findChildren(qt.QWidget)
        assert not [one for one in parts if one.styleSheet() and not isinstance(one.window(), qt.QDialog)], spec.key


# -- garbage is collected while the window is idle ---------------------------------------------------------
class Clock:
    """The processor time of a thread that works ``each_s`` between two ticks."""

    def __init__(self) -> None:
        self.now_s = self.each_s = 0.0

    def thread_time(self) -> float:
        return self.now_s

    def tick(self, collector: Collector) -> None:
        self.now_s += self.each_s
        collector.collect()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(garbage, "time", made)
    return made


@pytest.fixture
def collector(qapp: qt.QApplication) -> Iterator[Collector]:
    was_on, thresholds = gc.isenabled(), gc.get_threshold()
    made = Collector()
    made._timer.stop()
    yield made
    made.close()
    gc.set_threshold(*thresholds)
    assert gc.isenabled() == was_on


def test_old_objects_are_collected_only_while_the_window_is_idle(
    clock: Clock, collector: Collector, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All generations were collected while H was opened or scrubbed, whenever they were due: 50 to 110 ms."""
    collected: list[int] = []
    monkeypatch.setattr(gc, "collect", lambda generation=2: collected.append(generation))
    monkeypatch.setattr(gc, "get_count", lambda: (0, 0, 0))
    for _ in range(LATEST_TICKS + 1):
        clock.tick(collector)
    assert collected == [], "nothing is due"
    monkeypatch.setattr(gc, "get_count", lambda: (10**6, 10**6, 10**6))
    collector._ticks, clock.each_s = 0, 0.2
    for _ in range(LATEST_TICKS - 1):
        clock.tick(collector)
    assert collected == [0] * (LATEST_TICKS - 1), "the user works"
    clock.tick(collector)
    assert collected[-1] == 2, "after a long time they are collected nevertheless"
    clock.tick(collector)
    assert collected[-1] == 0
    clock.each_s = 0.0
    collected.clear()
    for _ in range(CALM_TICKS):
        clock.tick(collector)
    assert collected == [0] * (CALM_TICKS - 1) + [2], "the window is idle"


def test_a_window_that_waits_for_a_job_is_not_idle(
    clock: Clock, collector: Collector, monkeypatch: pytest.MonkeyPatch
) -> None:
    """H was opened in the background, and the window was blocked just when H was to be shown."""
    collected: list[int] = []
    monkeypatch.setattr(gc, "collect", lambda generation=2: collected.append(generation))
    monkeypatch.setattr(gc, "get_count", lambda: (10**6, 10**6, 10**6))
    collector._busy = lambda: True
    for _ in range(2 * CALM_TICKS):
        clock.tick(collector)
    assert set(collected) == {0}
    collector._busy = lambda: False
    for _ in range(CALM_TICKS):
        clock.tick(collector)
    assert collected[-1] == 2


def test_new_cycles_are_freed_and_modules_are_left_out(collector: Collector, clock: Clock) -> None:
    """Two thirds of all objects are modules and functions."""
    assert gc.get_freeze_count() > 10_000
    freed: list[int] = []

    class Link:
        other: Link

        def __del__(self) -> None:
            freed.append(1)

    one, two = Link(), Link()
    one.other, two.other = two, one
    del one, two
    assert not freed
    gc.set_threshold(0, 0, 0)
    for _ in range(CALM_TICKS + 1):
        [[] for _ in range(10)]
        clock.tick(collector)
    assert freed == [1, 1]


# -- benchmarks --------------------------------------------------------------------------------------------


def test_pictures_and_frames_are_shown_and_timed(qapp: qt.QApplication) -> None:
    scrubbed, live = scrubbing(0.01, pictures=3), live_frames(0.01, seconds=0.3)
    assert scrubbed["plane"] == "55 x 95 x 19²" and live["frame"] == "657 x 438 px"
    for found, key in ((scrubbed, "busy_ms"), (live, "busy_ms"), (live, "all_ms")):
        assert math.isfinite(found[key]) and found[key] > 0
    assert "per picture" in WORDS["scrubbing"](scrubbed) and "per second" in WORDS["live_frames"](live)
    assert set(WORDS) == set(MEASURED)


def test_the_command_measures_what_it_was_asked_for(
    qapp: qt.QApplication, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As ``python -m benchmarks window``, but for the time that measuring takes."""
    monkeypatch.setattr("benchmarks.window.scrubbing", lambda scale: {"scale": scale})
    words = ["window", "--small", "--only", "scrubbing", "--json"]
    command_line().main(words, standalone_mode=False)
    assert json.loads(capsys.readouterr().out) == {"scrubbing": {"scale": 0.1}}
    with pytest.raises(InputError, match="some of layout"):
        command_line().main(["window", "--only", "scrubing"], standalone_mode=False)


def test_screenshots_of_an_unknown_scene_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert take_pictures([str(tmp_path / "out"), "--scene", "start", "--size", "1280x800"]) == 2
    assert "--scene: expected some of empty" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_controls_are_counted_once_and_only_where_they_are_visible(qtbot: QtBot) -> None:
    root, inside = qt.QWidget(), qt.QWidget()
    qtbot.addWidget(root)
    column, rows = qt.QVBoxLayout(root), qt.QVBoxLayout(inside)
    hidden = qt.QPushButton("not seen")
    for part in (qt.QPushButton("a"), qt.QSpinBox(), qt.QComboBox(), qt.QLineEdit(), qt.QLabel("no control"), hidden):
        column.addWidget(part)
    area = qt.QScrollArea()
    area.setWidgetResizable(True)
    for k in range(40):
        rows.addWidget(qt.QPushButton(f"row {k}"))
    area.setWidget(inside)
    area.setFixedHeight(60)
    column.addWidget(area)
    hidden.hide()
    root.show()
    qt.QApplication.processEvents()
    reached = sum(not row.visibleRegion().isEmpty() for row in inside.findChildren(qt.QPushButton))
    assert 1 <= reached < 5 and len(controls(root)) == 4 + reached


def test_no_place_shows_more_than_20_controls_and_h_takes_its_share(qapp: qt.QApplication) -> None:
    found = layout()
    assert found["header"] <= 3 and found["rail"] == 5
    assert {name: one["controls"] for name, one in found["views"].items() if not 3 < one["controls"] <= 20} == {}
    assert {one["primary"] for one in found["views"].values()} == {1}
    shares = {"1920x1080": 0.45, "1280x800": 0.35, "1000x600": 0.28}
    assert all(found["shares"][size]["share"] > least for size, least in shares.items())
    assert "H and HT at 1280x800" in WORDS["layout"](found)


@pytest.mark.long
def test_hovering_over_the_sample_is_measured(qapp: qt.QApplication) -> None:
    times = hovering(20)
    assert all(math.isfinite(ms) and ms > 0 for name, ms in times.items() if not name.endswith("_long"))
    assert "HT drawn: median" in WORDS["hovering"](times)
