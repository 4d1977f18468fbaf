"""The folder of a session, and the plan of a target that is recorded instead of the scan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtWidgets import QFileDialog, QLineEdit, QWidget

from lfcal.base import InputError, read_text
from lfcal.camera import ScanPlan
from lfcal_gui.context import Context
from lfcal_gui.pages.acquire.model import AcquireSettings, moved
from lfcal_gui.pages.acquire.model_folder import FolderState, folder_state

if TYPE_CHECKING:
    from lfcal.targets import TargetPlan

CHOSEN, LOOKED_INTO = "acquire folder chosen", "acquire folder"


class FolderChoice:
    """The project's session folder.

    Parameters
    ----------
    context, edit
        Context of the page, and the line that contains the folder.
    seen
        Called with the state of the project's folder.
    refused
        Called with the reason if a folder is refused.
    """

    def __init__(
        self,
        context: Context,
        edit: QLineEdit,
        seen: Callable[[FolderState], None],
        refused: Callable[[str], None],
    ) -> None:
        self.context, self.edit = context, edit
        self._seen, self._refused = seen, refused

    def ask(self, then: Callable[[], None] | None = None) -> None:
        """Ask for a folder, and call ``then`` after it was accepted."""
        path = QFileDialog.getExistingDirectory(self.edit, "Folder of the session")
        if path:
            self.take(path, then)

    def take(self, path: str, then: Callable[[], None] | None = None) -> None:
        """Use another folder for the recording, or for resuming its session. A damaged folder is refused."""

        def seen(found: FolderState) -> None:
            if found.problem:
                self.edit.setText(self.context.state.recording)
                self._refused(found.problem)
            else:
                self.context.project.update("session folder", recording=path)
                if then is not None:
                    then()

        self.context.jobs.drop(CHOSEN)
        self.context.jobs.load(CHOSEN, lambda: folder_state(path), seen, self._refused)

    def look(self) -> None:
        """Read the state of the project's folder."""
        path = self.context.state.recording
        self.context.jobs.drop(LOOKED_INTO)  # an earlier read may hang on a slow disk
        self.context.jobs.load(LOOKED_INTO, lambda: folder_state(path), self._seen)

    def let_go(self) -> None:
        """Stop opening the folder of the previous project."""
        self.context.jobs.drop(CHOSEN)
        self.context.jobs.drop(LOOKED_INTO)


GROUP = "acquire target"


class TargetChoice:
    """The plan of the target in the project's settings, which is read when the settings name another file.

    Parameters
    ----------
    context
        Context of the page.
    read
        Called after reading: with an empty string, or with the reason if the plan cannot be read.
    """

    def __init__(self, context: Context, read: Callable[[str], None]) -> None:
        self.context, self._read = context, read
        self.plan: TargetPlan | None = None
        self._path = ""

    def ask(self, parent: QWidget) -> None:
        """Ask for the plan of a target; if a target is in use, return to the single point instead."""
        if AcquireSettings.of(self.context.state).target:
            self.clear()
        elif path := QFileDialog.getOpenFileName(parent, "Plan of a target", "", "Plans (*.json)")[0]:
            self.take(path)

    def take(self, path: str) -> None:
        """Use the target of a plan file; the project takes over the scan and the camera of this plan."""

        def seen(plan: TargetPlan) -> None:
            self.plan, self._path = plan, path
            settings = replace(AcquireSettings.of(self.context.state), target=path, extent="whole", order=None)
            self.context.project.update(
                f"target {Path(path).name}",
                plan=plan.scan,
                camera=plan.scan.camera,
                settings=settings.into(self.context.state),
            )
            self._read("")

        self.context.jobs.drop(GROUP)
        self.context.jobs.load(GROUP, lambda: _read_target_plan(path), seen, self._read)

    def clear(self) -> None:
        """Return to the scan of a single point."""
        settings = replace(AcquireSettings.of(self.context.state), target="")
        self.context.project.update("single point", settings=settings.into(self.context.state))

    def follow(self, path: str) -> None:
        """Read the plan that the settings name, unless it was read already."""
        if path == self._path:
            return
        self.plan, self._path = None, path
        self.context.jobs.drop(GROUP)
        if path:
            self.context.jobs.load(GROUP, lambda: _read_target_plan(path), self._seen, self._read)

    def _seen(self, plan: TargetPlan) -> None:
        self.plan = plan
        self._read("")

    def shown(self, scan: ScanPlan, folder: FolderState) -> ScanPlan | TargetPlan:
        """Return the plan whose recording is shown: that of the folder or, without one, the chosen plan."""
        if folder.target is not None:
            return folder.target
        found = self._moved(scan)
        return found if found is not None and found.scan == scan and folder.there is None else scan

    def _moved(self, scan: ScanPlan) -> TargetPlan | None:
        """Return the target's plan with the stage axes and origin of the project's scan."""
        if self.plan is None:
            return None
        return replace(self.plan, scan=moved(self.plan.scan, scan.stage.origin_um))

    def to_record(self, scan: ScanPlan, folder: FolderState) -> ScanPlan | TargetPlan:
        """Return the plan to record into a folder.

        Raises
        ------
        InputError
            If the target's plan was not read or belongs to another scan, or the folder contains another session.
        """
        remedy = "choose another folder, or the source of that session"
        if not self._path:
            if folder.target is not None:
                raise InputError.expected("folder", "a session of a single point", "a session of a target", remedy)
            return scan
        found = self._moved(scan)
        if found is None:
            raise InputError.expected(
                "plan of the target", "a readable plan", f"{self._path}, which could not be read", "choose another file"
            )
        if found.scan != scan:
            remedy = "open the target's plan again, or plan it for this scan"
            raise InputError.expected(
                "plan of the target", "a plan for the scan of this project", "a plan for another scan", remedy
            )
        if folder.there is not None and folder.target != found:
            raise InputError.expected(
                "folder", "a session of this target", "a session of another target or of a single point", remedy
            )
        return found


def _read_target_plan(path: str) -> TargetPlan:
    """Return the plan of a target in a file; raise `LfcalError` if there is none."""
    from lfcal.targets import TargetPlan  # here: a page is shown before simulators are loaded

    return TargetPlan.from_json(read_text(Path(path)))
