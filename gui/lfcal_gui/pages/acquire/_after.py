"""Steps after the recording of a session: assemble H or one plane of it, fit it, pack the files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.acquire import recipe_of
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import CommandStep, Filling, iter_made, new_file, shown_first
from lfcal_gui.pages.acquire.record_panel import RecordPanel
from lfcal_gui.pages.acquire.step import assembled, iter_assembly, remade
from lfcal_gui.saving import ask_target, may_replace

if TYPE_CHECKING:
    from lfcal.tasks import Assemble, AssembleTarget

Place = tuple[int, int, int]


class Afterwards:
    """Jobs on the session of a project; ``panel`` is the parent of dialogs, and shows H during its assembly."""

    def __init__(self, context: Context, panel: RecordPanel, recording: Callable[[], bool]) -> None:
        self.context, self.panel = context, panel
        self._recording, self.filling = recording, Filling()
        context.jobs.changed.connect(self._fill)

    def _fill(self, job: WindowJob) -> None:
        """Show H during its assembly, unless the map shows a running recording."""
        if job.page != "acquire" or not self.filling.follows(job.number, job.progress):
            return
        if not job.active or self._recording():
            self.panel.show_filling(None)
        elif self.filling.take(job.progress) and self.filling.plane is not None:
            z = self.filling.plane
            self.panel.show_filling(self.filling.light(z), self.filling.short_words(z))

    def open_plane(self, z: int) -> None:
        """Assemble a complete plane and show it, while the other planes are still being recorded."""
        folder = Path(self.context.state.recording)
        out = folder / f"plane-{z:02d}.h5"
        if may_replace(self.panel, [out]):
            self._assemble(out, planes=[z])

    def assemble(self, path: str = "") -> None:
        """Assemble H as a job."""
        folder = Path(self.context.state.recording)
        path = path or ask_target(self.panel, "Assemble H", str(folder / "H.h5"), "H file (*.h5)")
        if path:
            self._assemble(Path(path))

    def assemble_own(self) -> None:
        """Assemble the file H.h5 in the session's folder, unless this file exists and is not the project's H."""
        out = Path(self.context.state.recording) / "H.h5"
        if str(out) == self.context.state.psf or not out.exists():
            self._assemble(out)

    def fit(self, found: Any) -> None:
        """Assemble H, then show the fit ``found`` during the recording or, if there is none, the settings of a fit."""
        out = Path(self.context.state.recording) / "H.h5"
        if may_replace(self.panel, [out]):
            self._assemble(out, sent=found or "fit")

    def remake(self, places: Sequence[Place]) -> None:
        """Assemble the project's H again in a new file, after ``places`` of its session were recorded again.

        The previous H is kept and becomes the reference, so that the place H shows the difference.
        """
        folder, before = Path(self.context.state.recording), Path(self.context.state.psf)
        recipe = recipe_of(folder)

        def found(task: Assemble | AssembleTarget) -> None:
            title = f"Assemble {task.out.name}"
            step = partial(CommandStep.of, task)
            self.context.start_writing(
                title,
                "acquire",
                str(task.out),
                lambda: iter_made(task),
                lambda report: self._remade(report, before, places),
                taken=self.context.taken("acquire", title, step=step),
            )

        self.context.jobs.load(
            "acquire remake", lambda: remade(folder, before, new_file(before), recipe), found, self.context.refused.emit
        )

    def _remade(self, report: Any, before: Path, places: Sequence[Place]) -> None:
        path = self._psf_path(report)
        self.context.project.update("assembly of positions recorded again", psf=path, reference=str(before))
        self.context.go.emit("h", {"place": shown_first(places), "view": "difference"})

    def _assemble(self, out: Path, planes: list[int] | None = None, *, sent: Any = None) -> None:
        folder = Path(self.context.state.recording)
        recipe = recipe_of(folder)
        self.context.start_writing(
            f"Assemble {out.name}",
            "acquire",
            str(out),
            lambda: iter_assembly(folder, out, planes, recipe),
            lambda report: self._assembled(report, sent),
            taken=self.context.taken(
                "acquire", f"Assemble {out.name}", step=lambda: assembled(str(folder), str(out), planes, recipe)
            ),
        )

    def _assembled(self, report: Any, sent: Any) -> None:
        self.context.project.update("assembly", psf=self._psf_path(report))
        self.context.made.emit("h", sent)

    def _psf_path(self, report: Any) -> str:
        """Close H and return its file; report the verdict and notes of assembling as messages."""
        from lfcal.judge import judgement_of

        path = str(report.matrix.path)
        report.matrix.close()
        for note in (judgement_of(report).verdict, *report.notes):
            self.context.message.emit(f"{Path(path).name}: {note}")
        return path

    def pack(self) -> None:
        """Compress the finished recording as a job."""
        from lfcal.acquire import iter_finish

        folder = Path(self.context.state.recording)
        self.context.jobs.start(
            f"Pack {folder.name}",
            "acquire",
            lambda: iter_finish(folder),
            lambda packed: self.context.message.emit(
                "; ".join((f"packed: {packed.bytes_gained / 1e6:.1f} MB freed", *packed.left))
            ),
        )
