"""What the first look at a page loads and makes: the window is held meanwhile."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from pytestqt.qtbot import QtBot

from lfcal_gui.jobs import Jobs
from lfcal_gui.pages.acquire._pictures import ErrorView, RecordPictures
from lfcal_gui.pages.acquire.panel import AcquirePanel
from lfcal_gui.pages.h.panel import HPanel, LevelRow
from lfcal_gui.widgets._axes import Plot
from lfcal_gui.widgets.picture import Picture

LOADED = """
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
visit_all(Path({folder!r}))
print(json.dumps(loaded))
"""


def test_no_page_loads_what_only_its_work_needs(tmp_path: Path) -> None:
    """Scipy and matplotlib took half a second of the first look at a page."""
    code = LOADED.format(folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout.splitlines()[-1]) == []


STARTED = """
import json, sys, time
from pathlib import Path
from PySide6.QtWidgets import QApplication
from lfcal_gui.app import begin, make_window, parse

options, app = parse([]), QApplication([])
window = make_window(app, options, folder=Path({folder!r}))
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


def test_the_first_window_loads_neither_libraries_nor_what_opens_later(tmp_path: Path) -> None:
    """Lattice, image formats, H and two dialogs took a third of the start."""
    code = STARTED.format(folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded, later = json.loads(done.stdout.splitlines()[-1])
    libraries = {"scipy", "matplotlib", "numba", "tifffile", "cv2", "rawpy", "h5py", "yaml"}
    assert not libraries & set(loaded)
    parts = ("lfcal.lattice.", "lfcal.frames.", "lfcal.psf.", "lfcal.simulate.", "lfcal_gui.pages.setup._check_dialog")
    assert not [name for name in loaded if name.startswith(parts)]
    pages = {name.split(".")[2] for name in loaded if name.startswith("lfcal_gui.pages.") and name.count(".") > 2}
    assert pages == {"setup"}
    dialogs = {f"lfcal_gui.pages.setup._{name}_dialog" for name in ("check", "sensor", "target")}
    assert dialogs | {"lfcal.camera.importers.olaf_yaml", "lfcal.accuracy.parts.solvers"} <= set(later)


def test_pictures_of_a_fit_and_levels_of_the_inspector_are_made_when_they_are_wanted(qtbot: QtBot) -> None:
    panel = HPanel()
    qtbot.addWidget(panel)
    panel.show_fit(None)
    panel.apply_theme()
    assert panel.pictures.count() == 1 and panel.levels.count() == 1
    assert len(panel.findChildren(LevelRow)) == 3
    assert panel.fitted is panel.fitted and panel.pictures.count() == 2


def test_a_picture_without_axes_holds_no_plot(qtbot: QtBot) -> None:
    """Its colour bar was a plot of its own, with four axes and two menus."""
    view = Picture()
    qtbot.addWidget(view)
    assert not [item for item in view.graphics.scene().items() if isinstance(item, Plot)]


def test_the_record_tab_draws_a_session_only_where_it_is_looked_at(qtbot: QtBot) -> None:
    jobs = Jobs()
    panel = AcquirePanel(jobs)
    qtbot.addWidget(panel)
    panel.show()
    panel.record.show_error(None)
    panel.apply_theme()
    assert not panel.record.findChildren(RecordPictures)
    panel.setCurrentWidget(panel.record)
    assert panel.record.findChildren(RecordPictures) == [panel.record.pictures]
    assert panel.record.pictures.isVisible() and not panel.record.pictures.findChildren(ErrorView)
    jobs.close()
