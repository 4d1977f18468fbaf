"""Sittings in the window that are run as a user runs them, with a count of clicks, names and keys.

A click is a press of a mouse button. A name is a file name that is typed in a dialog and ended with Return. A key is
a press of any other key.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks._window_layout import new_stage

__all__ = ["SITTINGS", "Hand", "Sat", "clicks"]

BAD = ((0, 3, 4), (0, 9, 20), (0, 15, 7))
"""Positions (z, y, x) that are displaced in the sittings that repair bad positions."""

SMALL = (480, 640)
"""Rows and columns of the sensor in the Raytrix sitting: fewer than 29 megapixels, with the same clicks."""


@dataclass
class Sat:
    """Counts of a sitting.

    Attributes
    ----------
    clicks, names, keys
        Numbers of clicks, typed names and keys.
    did
        Descriptions of all of them, in order.
    """

    clicks: int = 0
    names: int = 0
    keys: int = 0
    did: list[str] = field(default_factory=list)


class Hand:
    """Clicks and keys on visible widgets in the window of a stage, with their counts.

    Parameters
    ----------
    stage
        `lfcal_gui.scenes.stage.Stage`.
    """

    def __init__(self, stage: Any) -> None:
        self.stage, self.window, self.folder, self.sat = stage, stage.window, stage.folder, Sat()

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait without counting; raise `TimeoutError` with what the window showed instead."""
        try:
            self.stage.until(condition, what)
        except TimeoutError as error:
            line, log = self.window.next_line, self.window.log_view.toPlainText().splitlines()[-3:]
            shown = f"{line.lead.text()} {line.words.text()} [{line.button.text()}]"
            raise TimeoutError(f"{error}; {', '.join(self.sat.did)}; {shown}; {'; '.join(log)}") from None

    def click(self, widget: Any, what: str = "") -> None:
        """Click a visible widget."""
        from PySide6.QtCore import Qt
        from PySide6.QtTest import QTest

        words = what or widget.text()
        self.until(lambda: widget.isVisible() and widget.isEnabled(), words)
        self.sat.clicks += 1
        self.sat.did.append(words)
        QTest.mouseClick(widget, Qt.MouseButton.LeftButton)

    def press(self, text: str, *, view: bool = False) -> None:
        """Click the visible button with this text in the rail or the current page, or the button of a ``view``."""
        from PySide6.QtWidgets import QAbstractButton

        def fits(one: Any) -> bool:
            named = text in (one.text().replace("&", ""), one.accessibleName().partition(":")[0])
            return named and one.isVisible() and (one.property("role") == "segment") == view

        def found() -> list[Any]:
            roots = (self.window.rail, self.window.shown)
            return [one for root in roots for one in root.findChildren(QAbstractButton) if fits(one)]

        self.until(found, f"a button {text}")
        self.click(found()[0], text)

    def key(self, keys: str, widget: Any = None) -> None:
        """Press a key, such as ``"Ctrl+M"``, in the window."""
        from PySide6.QtGui import QKeySequence
        from PySide6.QtTest import QTest

        pressed: Any = QKeySequence(keys)[0]  # type: ignore[index]
        self.sat.keys += 1
        self.sat.did.append(keys)
        QTest.keyClick(widget or self.window, pressed.key(), pressed.keyboardModifiers())

    def leads_to(self, button: str) -> None:
        """Wait until the line of the next step has this button, and no change of the line is pending."""
        line = self.window.next_line

        def there() -> bool:
            step = line.step
            return step is not None and step is line._wanted and line.button.text() == button

        self.until(there, button)

    def next(self, button: str) -> None:
        """Click the button of the next step."""
        self.leads_to(button)
        self.click(self.window.next_line.button)

    @contextmanager
    def named(self, path: Path, *, save: bool = False) -> Iterator[None]:
        """Answer the next file dialog: type the name of an existing file, or press Save for the proposed name."""
        from PySide6.QtWidgets import QFileDialog

        asked: list[str] = []

        def answer(*_: Any, **__: Any) -> tuple[str, str]:
            asked.append(str(path))
            return str(path), ""

        with ExitStack() as stack:
            for name in ("getSaveFileName", "getOpenFileName"):
                stack.enter_context(patch.object(QFileDialog, name, answer))
            stack.enter_context(patch.object(QFileDialog, "getExistingDirectory", lambda *_, **__: answer()[0]))
            yield
            self.until(lambda: asked, f"a dialog for {path.name}")
        if save:
            self.sat.clicks += 1
        else:
            self.sat.names += 1
        self.sat.did.append("Save" if save else f"name of {path.suffix or 'folder'}")


# -- sittings ----------------------------------------------------------------------------------------------
def sample(hand: Hand) -> None:
    """Open the sample: H, HT, the depth-plane sums, the aperture and the verdict are shown."""
    welcome = hand.window.tools.welcome()
    hand.click(welcome.buttons["sample"])
    hand.until(lambda: hand.window.project.state.psf, "H")
    hand.stage.settle()
    panel = hand.window.shown.panel
    assert all(view.values is not None and view.isVisible() for view in (panel.main_view, panel.linked_view))
    hand.leads_to("Export as .mat")
    assert hand.window.leading.sitting.verdict is not None


def sample_export(hand: Hand) -> None:
    """Export H and HT of the sample, whose hexagonal array no other code can use, to a plain file."""
    _opened(hand)
    hand.leads_to("Export as .mat")
    with hand.named(out := hand.folder / "sample.mat", save=True):
        hand.next("Export as .mat")
    hand.leads_to("Show folder")
    assert out.stat().st_size > 1e6


def raytrix(hand: Hand) -> None:
    """From a Raytrix XML to a verdict on H, with the simulated rig."""
    file, project = hand.folder / "camera.xml", hand.window.project
    file.write_text(XML, encoding="utf-8")
    with hand.named(file):
        hand.next("Import …")
    hand.until(lambda: len(project.state.camera.lattice.types) == 3, "the camera")
    sensor = replace(project.state.camera.sensor, shape=SMALL)
    project.update("a smaller sensor", camera=replace(project.state.camera, sensor=sensor))
    hand.next("Plan the scan")
    hand.until(lambda: project.state.plan is not None, "the plan")
    _shorten(hand)
    hand.next("Use the simulated rig")
    hand.next("Record")
    hand.until(lambda: project.state.psf, "H")
    hand.until(lambda: hand.window.leading.sitting.verdict is not None, "a verdict")


def folder(hand: Hand) -> None:
    """From a folder of frames of another program to H."""
    hand.window.go("frames")
    with hand.named(_frames(hand.folder)):
        hand.press("Import any folder …")
    _assembled(hand)


def dropped(hand: Hand) -> None:
    """From a folder of frames, dropped on the window, to H."""
    hand.window.take_files([str(_frames(hand.folder))])
    _assembled(hand)


def computed(hand: Hand) -> None:
    """Compute H of a plan, after its time and error are shown."""
    _planned(hand)
    hand.press("Record")
    hand.press(next(spec.title for spec in hand.window.specs if spec.key == "simulate"), view=True)
    hand.stage.settle()
    panel = hand.window.shown.panel
    assert panel.seconds.text() not in ("", "…") and "%" in panel.error.text()
    hand.next("Compute H")
    hand.until(lambda: hand.window.project.state.psf, "H")
    hand.stage.settle()


def fitted(hand: Hand) -> None:
    """Fit the optics of H."""
    _opened(hand)
    page = hand.window.page("h")
    page.fitting._edited("positions", 12)
    hand.click(page.panel.rows["fit"], "Fit of the optics")
    hand.stage.settle()
    hand.press("Fit")
    hand.until(lambda: hand.window.context.fitted is not None, "the fit")
    hand.stage.settle()


def reconstructed(hand: Hand) -> None:
    """Reconstruct a volume of a light field."""
    _opened(hand)
    page = hand.window.page("reconstruct")
    page.context.edit(page.settings, "iterations", 3)
    page.make_light_field("points", str(hand.folder / "points.tif"))
    hand.stage.settle()
    hand.window.project.update("none", light_field="")
    hand.window.go("h")
    hand.press("Use")
    with hand.named(hand.folder / "points.tif"):
        hand.press("Open light field …")
    hand.next("Reconstruct")
    hand.until(lambda: hand.window.leading.sitting.volume, "the volume")
    hand.stage.settle()


def multiplexed(hand: Hand) -> None:
    """Open Multiplexing by its key."""
    hand.key("Ctrl+M")
    hand.until(lambda: hand.window.page("multiplex").isVisible(), "the window")


def repaired(hand: Hand) -> None:
    """Record bad positions again: the new H and its difference from the old one are shown."""
    first = _deceived(hand)
    window = hand.window
    window.go("acquire")
    page = window.page("acquire")
    hand.until(lambda: page.panel.setup.devices.backend.count() > 0, "the list of devices")
    page.setup.connect_devices()
    hand.until(lambda: page.setup.station is not None, "the simulator")
    window.go("h")
    hand.next(f"Record {len(BAD)} positions")
    _compared(hand, first)


def left_out(hand: Hand) -> None:
    """Leave bad positions out and fill them from a fit: the new H and its difference from the old one are shown."""
    first = _deceived(hand)
    hand.next("Leave them out")
    _compared(hand, first)
    hand.leads_to("Export as .mat")


SITTINGS: Mapping[str, Callable[[Hand], None]] = {
    one.__name__: one
    for one in (
        *(sample, sample_export, raytrix, folder, dropped, computed),
        *(fitted, reconstructed, multiplexed, repaired, left_out),
    )
}
"""All sittings by name; the first line of their docstring says what each does."""


# -- initial states ----------------------------------------------------------------------------------
XML = """<?xml version="1.0"?><RayCalibData version="1.0"><offset units="pix"><x>22.07</x><y>8.62</y></offset>
<diameter units="pix">11.0</diameter><rotation units="rad">2.5e-5</rotation><lens_border units="pix">1</lens_border>
<tcp units="virtual_depth">2.1</tcp>
<lens_base_x units="lens"><x>-1.0</x><y>0.0</y></lens_base_x>
<lens_base_y units="lens"><x>-0.5</x><y>-0.8660254</y></lens_base_y>
<sub_grid_base units="lens"><x>-3.0</x><y>-1.7320508</y></sub_grid_base>
<lens_type id="0"><offset units="lens"><x>0.0</x><y>0.0</y></offset>
<depth_range units="virtual_depth"><min>1</min><max>3</max></depth_range></lens_type>
<lens_type id="1"><offset units="lens"><x>-1.0</x><y>0.0</y></offset>
<depth_range units="virtual_depth"><min>2</min><max>4</max></depth_range></lens_type>
<lens_type id="2"><offset units="lens"><x>1.0</x><y>0.0</y></offset>
<depth_range units="virtual_depth"><min>3</min><max>5</max></depth_range></lens_type></RayCalibData>"""
"""A Raytrix calibration with three lens types, and with micro-images small enough to be recorded in a test."""


def _plan(planes: int = 1) -> Any:
    """Return the plan of the sample with fewer planes."""
    from lfcal.camera import ScanPlan
    from lfcal.simulate import sample_session

    plan = ScanPlan.from_json((sample_session() / "plan.json").read_text(encoding="utf-8"))
    return replace(plan, depths_um=plan.depths_um[:planes], exposure_s=plan.exposures[:planes], settle_s=0.0)


def _planned(hand: Hand) -> None:
    plan = _plan()
    hand.window.project.update("plan", camera=plan.camera, plan=plan)


def _shorten(hand: Hand) -> None:
    """Reduce the plan to one plane, which makes the same sitting ten times shorter."""
    plan = hand.window.project.state.plan
    assert plan is not None
    one = replace(plan, depths_um=plan.depths_um[:1], exposure_s=plan.exposures[:1], settle_s=0.0)
    hand.window.project.update("one plane", plan=one)


def _opened(hand: Hand) -> None:
    from lfcal_gui.scenes.sample import open_sample

    open_sample(hand.stage)


def _frames(folder: Path) -> Path:
    """Return a copy of the frames of the sample, as frames of another program."""
    from lfcal.simulate import sample_session

    return Path(shutil.copytree(sample_session(), folder / "theirs"))


def _assembled(hand: Hand) -> None:
    hand.next("Assemble H")
    hand.until(lambda: hand.window.project.state.psf, "H")
    hand.until(lambda: hand.window.shown.spec.place == "h", "H to be shown")
    hand.stage.settle()


class _Deceived:
    """A stage that is displaced at a few positions, which its encoder does not report."""

    waits = False

    def __init__(self, stage: Any, bad: np.ndarray[Any, Any]) -> None:
        self._stage, self._bad = stage, bad
        self._asked: tuple[float, float, float] = stage.position()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stage, name)

    def move(self, target: tuple[float, float, float]) -> None:
        self._asked = target
        off = float(np.abs(self._bad - target).max(axis=1).min()) < 1.0
        self._stage.move((target[0] + 60.0, target[1] + 40.0, target[2]) if off else target)

    def position(self) -> tuple[float, float, float]:
        return self._asked


def _deceived(hand: Hand) -> Path:
    """Open a session with a few displaced positions, and its H; wait for the verdict."""
    from lfcal.acquire import Options, record
    from lfcal.devices import open_rig
    from lfcal.tasks import Assemble

    plan, place = _plan(), Path(hand.folder) / "session"
    with open_rig(plan, "sim", {}) as rig:
        deceived = replace(rig, stage=_Deceived(rig.stage, plan.stage_um(np.array(BAD))))
        record(place, plan, deceived, Options(reference_every=0, check_stage=False))
    (made,) = Assemble(frames=place, out=place / "H.h5").run()
    made.close()
    state = {"plan": plan, "camera": plan.camera, "recording": str(place), "psf": str(place / "H.h5")}
    hand.window.project.update("a session", **state)
    hand.window.go("h")
    hand.until(lambda: hand.window.leading.sitting.bad == len(BAD), "a verdict with bad positions")
    return place / "H.h5"


def _compared(hand: Hand, first: Path) -> None:
    project, page = hand.window.project, hand.window.page("h")
    hand.until(lambda: project.state.psf == str(first.with_name("H-2.h5")), "the new H")
    hand.until(lambda: page.plane is not None and page.reference is not None, "both H")
    assert hand.window.shown is page and page.intent.view == "difference"
    assert (page.intent.z, page.intent.y, page.intent.x) in BAD and project.state.reference == str(first)
    hand.until(lambda: hand.window.leading.sitting.verdict is not None, "the new verdict")
    hand.stage.settle()


# -- the table ---------------------------------------------------------------------------------------------
def clicks(names: Iterable[str] = SITTINGS) -> dict[str, dict[str, Any]]:
    """Return the counts of each sitting, each in a new window."""
    found = {}
    for name in names:
        with TemporaryDirectory() as place:
            stage = new_stage(Path(place))
            hand = Hand(stage)
            with patch("lfcal_gui.context.results", lambda: stage.folder / "results"):  # noqa: B023
                SITTINGS[name](hand)
            stage.window.shut_down()
            stage.window.close()
        found[name] = {"what": (SITTINGS[name].__doc__ or "").partition("\n")[0], **vars(hand.sat)}
    return found
