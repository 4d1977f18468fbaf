"""How far a recording is, and how it ended, in words."""

from __future__ import annotations

from lfcal.acquire import Control, Devices, Options
from lfcal.base import Progress, format_seconds
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.pages.acquire.model_recorder import FolderState, Recorder
from lfcal_gui.pages.acquire.model_until import until_words

__all__ = ["advice_words", "asked_words", "automatic_words", "end_words", "progress_words"]


def progress_words(recorder: Recorder, record: Progress, lamp: str) -> tuple[str, str, float | None]:
    """Return how far it is, details with ``lamp``, and the fraction that is done, None where nobody knows."""
    if recorder.goal is not None:
        words, detail = until_words(record, recorder.steps, recorder.taken)
        return words, _joined(detail, lamp), record.fraction if record.total else None
    rate = recorder.rate
    left = (record.total - record.done) / rate if rate > 0 else None
    pace = f"{rate:.0f} per second, about {format_seconds(left)} to go" if left else ""
    words = f"{record.done} of {record.total} {recorder.counted}"
    return words, _joined(record.note or pace, lamp), record.fraction


def asked_words(control: Control, *, stopping: bool) -> str:
    """Return what a recording was asked to do and has not done yet; ``stopping``: its job is to stop."""
    if control.aborting:
        return "Aborting: nothing more is taken …"
    if control.stopping or stopping:
        return "Stopping once the position under way is safe …"
    if control.pausing and control.held != "paused":
        return "Pausing once the position under way is safe …"
    return "Going on …" if control.held == "paused" and not control.pausing else ""


def end_words(job: WindowJob, ended: str, counted: str = "positions") -> tuple[str, float]:
    """Return how a recording ended and the fraction that is done; ``ended``: why it needed no more, if it did."""
    if job.state is JobState.DONE:
        found = job.result
        words = f"{found.how.capitalize()}: {found.acknowledged} of {found.total} {counted}."
        if ended:
            words = f"{ended[0].upper()}{ended[1:]}."
        return words, found.acknowledged / max(1, found.total)
    words = {JobState.FAILED: "Stopped by a fault.", JobState.CANCELLED: "Interrupted."}.get(job.state, "")
    return words, job.progress.fraction if job.progress is not None else 0.0


def automatic_words(devices: Devices, options: Options) -> str:
    """Return what to do about settings by which the camera changes frames; empty: there are none, or they may be."""
    if not devices.automatic or options.allow_automatic:
        return ""
    return (
        f"The camera changes frames automatically: {devices.automatic_words}. Switch this off in the program of its "
        "maker and connect again, or tick Allow automatic."
    )


def _joined(*parts: str) -> str:
    return ", ".join(part for part in parts if part)


def advice_words(folder: FolderState, *, recording: bool, backend: str, measured: bool) -> str:
    """Return what comes next, in words.

    Parameters
    ----------
    folder
        What the session's folder holds.
    recording
        Whether a session is being recorded.
    backend
        Name of the devices that are to be connected; empty: they are.
    measured
        Whether the stage's axes are.
    """
    if recording:
        return "Recording continues while you use other pages."
    if folder.complete and folder.target is not None:
        return "Complete. Assemble H of the points that meet phases; lfcal fit takes all of them where they are."
    if folder.complete and folder.chosen is not None:
        return "Fit takes what was recorded to the page Fit; with a smaller error the session goes on."
    if folder.complete:
        return "Complete. Assemble H, or choose another folder for a new session."
    if backend:
        name = "the simulator" if backend == "sim" else backend
        return f"Start connects {name} and asks for a folder if there is none."
    return "" if measured else "The stage axes are not measured yet: Adjust the rig does it in seconds."
