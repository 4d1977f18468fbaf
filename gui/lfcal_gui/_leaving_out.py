"""Leave bad positions out of H: a fit of H fills them. The previous H becomes the reference."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from lfcal_gui.context import Context
from lfcal_gui.models import CommandStep, WithoutBad, iter_made, kept_verdict, shown_first, without_bad

GROUP, PAGE = "leave out", "frames"


class LeavingOut:
    """Two consecutive jobs: the fit of H, and the assembly of H without the positions, with the settings of the old H.

    The file of the old H is kept, and the old H becomes the reference.
    """

    def __init__(self, context: Context) -> None:
        self.context = context

    def begin(self) -> None:
        """Leave out the positions that the verdict on H lists."""
        context, verdict = self.context, kept_verdict(self.context.state)
        if verdict is None or not verdict.redo or context.jobs.loading(GROUP):
            return
        psf, places = Path(context.state.psf), [(int(z), int(y), int(x)) for z, y, x in verdict.redo]
        context.jobs.load(
            GROUP, lambda: without_bad(psf, places), lambda how: self._fit(how, psf, places), context.refused.emit
        )

    def _fit(self, how: WithoutBad, psf: Path, places: Sequence[tuple[int, int, int]]) -> None:
        fit, begun = how.fit, self.context.project.begun
        if fit is None:
            self._assemble(how, psf, places)
            return
        title = f"Fit {psf.name}"
        self.context.jobs.start(
            title,
            "h",
            lambda: fit.work(),
            lambda _: self._assemble(how, psf, places) if self.context.project.begun == begun else None,
            kind="fit",
            needs=(str(psf),),
            taken=self.context.taken("fit", title, str(fit.out), partial(CommandStep.of, fit)),
        )

    def _assemble(self, how: WithoutBad, psf: Path, places: Sequence[tuple[int, int, int]]) -> None:
        task, title = how.assemble, f"Assemble {how.assemble.out.name}"

        def work() -> Any:
            how.write_list()
            return (yield from iter_made(task))

        files = ((str(task.leave_out), how.listed),)
        self.context.start_writing(
            title,
            PAGE,
            str(task.out),
            work,
            lambda report: self._made(report, psf, places),
            taken=self.context.taken(PAGE, title, str(task.out), partial(CommandStep.of, task, files)),
        )

    def _made(self, report: Any, psf: Path, places: Sequence[tuple[int, int, int]]) -> None:
        path = str(report.matrix.path)
        report.matrix.close()
        self.context.project.update("positions left out of H", psf=path, reference=str(psf))
        self.context.made.emit("h", {"place": shown_first(places), "view": "difference"})
