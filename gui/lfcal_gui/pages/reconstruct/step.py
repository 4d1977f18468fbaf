"""Export and reconstruction as commands. No Qt."""

from __future__ import annotations

from dataclasses import replace

from lfcal.base import InputError
from lfcal.tasks import ReconstructBars, python_of, words_of
from lfcal_gui.models import CommandStep, ProjectState, kept_verdict, needed_file, stated_order
from lfcal_gui.pages.reconstruct.export_model import ExportSettings
from lfcal_gui.pages.reconstruct.model import ReconstructSettings, bars_task_of, task_of
from lfcal_gui.pages.reconstruct.model_regions import labels_file


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that reconstructs the light field or, without one, that exports H."""
    psf = needed_file(project.psf, "H", "H")
    if not project.light_field:
        return export_step(project, out)
    chosen = ReconstructSettings.of(project)
    if chosen.region:
        raise InputError.expected("region", "the whole light field", chosen.region, "clear Region")
    task = task_of(chosen, psf, project.light_field, out or "volume.tif", stated_order(project, psf))
    return CommandStep(words_of(task), python_of(task))


def bars_task(project: ProjectState, out: str, *, drawn: bool = False) -> ReconstructBars:
    """Return the task that reconstructs the light field with error bars.

    With ``drawn``, the sums are those over drawn regions, whose labels are in `labels_file`.

    Raises
    ------
    InputError
        If only a region of the light field is used, or regions are drawn and also given by a file of labels.
    """
    chosen = ReconstructSettings.of(project)
    if chosen.region:
        raise InputError.expected("region", "the whole light field", chosen.region, "clear Region")
    if drawn:
        if chosen.labels:
            wanted, remedy = "no file, because regions are drawn", "clear Labels, or choose Overlay > Remove regions"
            raise InputError.expected("labels", wanted, chosen.labels, remedy)
        chosen = replace(chosen, labels=str(labels_file(out)))
    return bars_task_of(chosen, project.psf, project.light_field, out, stated_order(project, project.psf))


def export_step(
    project: ProjectState, out: str = "", chosen: ExportSettings | None = None, code: str = ""
) -> CommandStep:
    """Return the step that exports H for a code or according to the options; by default for MATLAB."""
    psf = needed_file(project.psf, "H", "H")
    chosen = chosen or (ExportSettings.of_path(out) if out else ExportSettings())
    out, order = out or f"H{chosen.suffix_for(code)}", stated_order(project, psf)
    return CommandStep.of(chosen.task(psf, out, order, code, quality_in(project)))


def quality_in(project: ProjectState) -> str:
    """Return the word for the quality of H that is written into a file; empty: H was not judged."""
    verdict = kept_verdict(project)
    return "" if verdict is None or verdict.merit == "unknown" else verdict.merit
