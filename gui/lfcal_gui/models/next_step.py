"""The next step, and the words of the rail; both follow from one record, `Sitting`. No Qt.

`next_step` goes through `ROWS`; the first row that applies determines the next step. Optional steps on the way to H
do not delay it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from lfcal.base import format_bytes, format_count, format_share
from lfcal_gui.models.verdict import Verdict
from lfcal_gui.models.words import rough_seconds

LONGEST = 90
"""Largest number of characters of the line, including its lead."""

PLACES = ("setup", "record", "h", "use")
BEFORE_H = PLACES[:2]
Place = Literal["setup", "record", "h", "use"]
Mark = Literal["good", "fair", "bad", ""]

JOBS: dict[str, tuple[str, Place]] = {
    "sample": ("Opening the sample", "h"),
    "make": ("Assembling H", "h"),
    "compute": ("Computing H", "h"),
    "judge": ("Judging H", "h"),
    "fit": ("Fitting the optics", "h"),
    "reconstruct": ("Reconstructing", "use"),
    "depth": ("Measuring depth", "use"),
    "export": ("Exporting H", "use"),
}
"""Kinds of jobs that the line shows, each with its lead and its place."""


DEVICE = re.compile(r"^(?:stopped )?at position .*? by the [a-z ]+: ")
"""Beginning of a message that states where a recording was stopped; the reason follows."""


@dataclass(frozen=True)
class Sitting:
    """All facts on which the next step depends, as plain values.

    Attributes
    ----------
    place
        Key of the current place.
    declined
        Actions of optional steps that the user declined with "Not now".
    camera, white
        Whether a camera was described, and compared with a white image.
    assumed
        Names of assumed values on which time, cutout or H depend.
    wrong, movable
        Reason why the plan cannot work (empty: it can), and whether moving the scan on the sensor helps.
    plan, positions, planes, counted
        Whether there is a plan; its numbers of positions and planes; what is counted (``"frame"`` for a target, whose
        numbers are those of the frames).
    record_s, frame_bytes
        Forecast of the recording time (None: not available), and disk space for its frames.
    source
        Source of H: ``"rig"``, ``"folder"`` or ``"compute"``.
    folder, unread, frames, missing, fresh
        Whether a folder of frames is chosen; reason why its frames cannot be used; their number (0: not yet known);
        number of positions without a frame; whether H is older than the frames.
    corrections
        Corrections of these frames that are possible but not applied: ``"dark"``.
    make_s, compute_s, error
        Forecasts of the time for assembling and for computing H (None: not available), and relative error of a
        computed H.
    simulated, rig, rig_measured, free_bytes
        Whether the simulated devices are chosen; whether devices are connected; whether scale and axes of the stage
        are measured; free space on the disk of the session (None: unknown).
    recording, paused, stopped
        Whether a session is being recorded, or is paused; reason why the last run stopped early.
    done, total, plane, left_s
        Number of positions saved to disk, and of all; index of the current plane; remaining time (s).
    job, job_words, job_left_s
        Kind of the running job, one of `JOBS`, with its stage and remaining time.
    h, h_camera, verdict, filled
        Whether there is an H; whether its file states a camera; its verdict (None: not judged); number of bad
        positions that a model has filled.
    export_title, export_ht, export_bytes
        Name of the offered export, whether its file contains HT, and the size of its values without compression.
    exported, exported_bytes
        File that H was exported to, and its size.
    light_field, volume, voxels, reconstruct_s, depth_s
        Whether there are a light field and its volume; voxels (z, y, x); forecasts of reconstruction and depth map.
    """

    place: Place = "setup"
    declined: frozenset[str] = frozenset()
    camera: bool = False
    white: bool = False
    assumed: tuple[str, ...] = ()
    wrong: str = ""
    movable: bool = False
    plan: bool = False
    positions: int = 0
    planes: int = 0
    counted: Literal["position", "frame"] = "position"
    record_s: float | None = None
    frame_bytes: float = 0.0
    source: Literal["rig", "folder", "compute"] = "rig"
    folder: bool = False
    unread: str = ""
    frames: int = 0
    missing: int = 0
    fresh: bool = False
    corrections: tuple[str, ...] = ()
    make_s: float | None = None
    compute_s: float | None = None
    error: float | None = None
    simulated: bool = False
    rig: bool = False
    rig_measured: bool = False
    free_bytes: float | None = None
    recording: bool = False
    paused: bool = False
    stopped: str = ""
    done: int = 0
    total: int = 0
    plane: int = 0
    left_s: float | None = None
    job: str = ""
    job_words: str = ""
    job_left_s: float | None = None
    h: bool = False
    h_camera: bool = False
    verdict: Verdict | None = None
    filled: int = 0
    export_title: str = "Export H"
    export_ht: bool = False
    export_bytes: float = 0.0
    exported: str = ""
    exported_bytes: float = 0.0
    light_field: bool = False
    volume: bool = False
    voxels: tuple[int, int, int] = (0, 0, 0)
    reconstruct_s: float | None = None
    depth_s: float | None = None

    @property
    def unfinished(self) -> bool:
        """Whether a session was started and is not complete."""
        return 0 < self.done < self.total

    @property
    def bad(self) -> int:
        """Number of bad positions that one click repairs: all with a rig, else those not yet filled."""
        if self.verdict is None or not self.verdict.few:
            return 0
        return self.verdict.bad if self.rig else max(0, self.verdict.bad - self.filled)

    @property
    def needs_h(self) -> bool:
        """Whether H must still be made."""
        return not self.h or self.fresh


@dataclass(frozen=True)
class Step:
    """The next step.

    Attributes
    ----------
    lead, words
        Word in front of the sentence, such as ``"Next"``, ``"Recording"`` or ``"Done"``; and the sentence.
    button, action
        Label and action (``"page.name"``) of the button.
    place
        Key of the place where it is done.
    optional
        Whether it can be skipped.
    stop
        Action of a second button *Stop*; empty if there is none.
    other
        Optional step that can be done first.
    """

    lead: str
    words: str
    button: str
    action: str
    place: Place
    optional: bool = False
    stop: str = ""
    other: Step | None = None

    @property
    def line(self) -> str:
        """Lead and words as one line."""
        return f"{self.lead}: {self.words}"


@dataclass(frozen=True)
class RailWords:
    """Words and mark of a place in the rail."""

    words: str
    mark: Mark = ""


def next_step(sitting: Sitting) -> Step:
    """Return the next step: the first row that applies, without declined optional steps.

    An optional step on the way to H is offered next to the step that has to be done.
    """
    other: Step | None = None
    for row in ROWS:
        step = row(sitting)
        if step is None or (step.optional and step.action in sitting.declined):
            continue
        if not (step.optional and step.place in BEFORE_H):
            return replace(step, other=other)
        other = other or step
    raise AssertionError("the last row of the table has no condition, so it must apply")


# -- words -------------------------------------------------------------------------------------------------
def _takes(seconds: float | None, before: str = ", ", about: str = "about ") -> str:
    """Return a forecast as the end of a sentence; empty if there is none."""
    return "" if seconds is None else f"{before}{rough_seconds(seconds, about)}"


def _left(seconds: float | None) -> str:
    return _takes(seconds, about="") + (" left" if seconds is not None else "")


def _count(many: int, one: str) -> str:
    """Return a count with its noun and a thousands separator."""
    return format_count(many, one, f"{one}s")


def _short(text: str, most: int) -> str:
    """Return ``text`` as one line of at most ``most`` characters."""
    words = " ".join(text.split()).rstrip(".")
    return words if len(words) <= most else f"{words[: most - 1].rpartition(' ')[0].rstrip(' ,;:')}…"


def _cause(stopped: str, most: int) -> str:
    """Return why a recording stopped, as a sentence without the position and the remedy, which the page shows."""
    words = _short(DEVICE.sub("", stopped).partition(";")[0], most)
    return words if words.endswith("…") else f"{words}."


def _scan(s: Sitting) -> str:
    return f"{_count(s.positions, s.counted)} in {_count(s.planes, 'plane')}"


# -- rows --------------------------------------------------------------------------------------------------
def _stopped(s: Sitting) -> Step | None:
    if not s.stopped or s.recording:
        return None
    return Step("Stopped", f"{_cause(s.stopped, 56)} Recorded data are safe.", "Resume", "acquire.resume", "record")


def _recording(s: Sitting) -> Step | None:
    if not s.recording or s.paused:
        return None
    of = f"plane {s.plane + 1} of {s.planes}: " if s.planes else ""
    words = f"{of}{s.done:,} of {_count(s.total, s.counted)}{_left(s.left_s)}."
    return Step("Recording", words, "Pause", "acquire.pause", "record", stop="acquire.stop")


def _paused(s: Sitting) -> Step | None:
    if not (s.paused or (s.unfinished and not s.recording)):
        return None
    left = max(0, s.total - s.done)
    verb = "is" if left == 1 else "are"
    words = f"{_count(left, s.counted)} {verb} left{_takes(s.left_s, about='')}."
    return Step("Paused", words, "Resume", "acquire.resume", "record")


def _working(s: Sitting) -> Step | None:
    if s.job not in JOBS:
        return None
    lead, place = JOBS[s.job]
    words = f"{_short(s.job_words, 48) or 'running'}{_left(s.job_left_s)}."
    return Step(lead, words, "Stop", f"jobs.{s.job}", place)


def _camera(s: Sitting) -> Step | None:
    if s.camera or s.h or s.source == "folder":
        return None
    return Step("Next", "choose the camera.", "Import …", "setup.import", "setup")


def _camera_of_h(s: Sitting) -> Step | None:
    if not s.h or s.camera or s.h_camera:
        return None
    words = "choose the camera of this H, to judge it fully."
    return Step("Next", words, "Import …", "setup.import", "setup", optional=True)


def _wrong_plan(s: Sitting) -> Step | None:
    if not s.wrong or not s.needs_h or s.source == "folder":
        return None
    if s.movable:
        return Step("Next", f"{_short(s.wrong, 60)}: move the scan.", "Move it", "setup.move", "setup")
    return Step("Next", f"change the plan: {_short(s.wrong, 60)}.", "Show the plan", "setup.show", "setup")


def _assumed(s: Sitting) -> Step | None:
    if not s.assumed or not s.camera or not s.needs_h or s.source == "folder":
        return None
    names = _short(", ".join(s.assumed), 40)
    words = f"confirm {_count(len(s.assumed), 'assumed value')}: {names}."
    return Step("Next", words, "Show them", "setup.assumed", "setup", optional=True)


def _white(s: Sitting) -> Step | None:
    if s.white or not s.camera or not s.needs_h or s.source == "folder":
        return None
    words = "compare the camera with a white image."
    return Step("Next", words, "White image …", "setup.white", "setup", optional=True)


def _unread(s: Sitting) -> Step | None:
    if s.source != "folder" or not s.unread or not s.needs_h:
        return None
    return Step("Next", f"{_short(s.unread, 60)}.", "Import …", "frames.columns", "record")


def _plan(s: Sitting) -> Step | None:
    if s.plan or not s.needs_h:
        return None
    return Step("Next", "plan the scan; lfcal derives it from the camera.", "Plan the scan", "setup.make", "setup")


def _assemble(s: Sitting) -> Step | None:
    if s.source != "folder" or not s.needs_h:
        return None
    if not s.folder:
        return Step("Next", "choose the folder with the frames.", "Import folder …", "frames.import", "record")
    frames = _count(s.frames, "frame") if s.frames else "the frames"
    words = f"assemble H from {frames}{_takes(s.make_s)}."
    if s.missing > s.frames:
        total = _count(s.frames + s.missing, "position")
        words = f"assemble H from {frames}; {s.missing:,} of {total} have none."
    return Step("Next", words, "Assemble H", "frames.assemble", "record")


def _assemble_session(s: Sitting) -> Step | None:
    if s.h or not s.total or s.done < s.total or s.source != "rig":
        return None
    words = f"assemble H from {_count(s.total, f'recorded {s.counted}')}{_takes(s.make_s)}."
    return Step("Next", words, "Assemble H", "acquire.assemble", "record")


def _compute(s: Sitting) -> Step | None:
    if s.source != "compute" or not s.needs_h:
        return None
    off = "" if s.error is None else f", error {format_share(s.error)}"
    words = f"compute H: {_count(s.planes, 'plane')}{off}{_takes(s.compute_s)}."
    return Step("Next", words, "Compute H", "simulate.compute", "record")


def _connect(s: Sitting) -> Step | None:
    if s.h or s.rig:
        return None
    words = f"record the {'scan' if s.counted == 'position' else 'target'}: {_scan(s)}{_takes(s.record_s)}."
    button = "Use the simulated rig" if s.simulated else "Connect camera and stage"
    return Step("Next", words, button, "acquire.connect", "record")


def _disk(s: Sitting) -> Step | None:
    if s.h or s.free_bytes is None or s.frame_bytes <= s.free_bytes:
        return None
    need, free = format_bytes(s.frame_bytes), format_bytes(s.free_bytes)
    words = f"the frames need {need}, but only {free} are free: choose another folder."
    return Step("Next", words, "Choose folder …", "acquire.folder", "record")


def _adjust(s: Sitting) -> Step | None:
    if s.h or s.rig_measured:
        return None
    words = "measure the scale and axes of the stage."
    return Step("Next", words, "Adjust", "acquire.adjust", "record", optional=True)


def _record(s: Sitting) -> Step | None:
    if s.h:
        return None
    return Step("Next", f"record {_scan(s)}{_takes(s.record_s)}.", "Record", "acquire.record", "record")


def _judge(s: Sitting) -> Step | None:
    if s.verdict is not None:
        return None
    return Step("Next", "judge H.", "Judge H", "h.judge", "h", optional=True)


def _few_bad(s: Sitting) -> Step | None:
    v = s.verdict
    if v is None or not s.bad:
        return None
    many = _count(s.bad, "position")
    bad = many.replace(" ", " bad ")
    rest = "good" if v.rest == "good" else "usable"
    if s.rig:
        words = f"record {many} again; the rest of H is {rest}."
        return Step("Next", words, f"Record {many}", "acquire.redo", "h", optional=v.usable)
    if s.folder or s.total:
        them = "it" if s.bad == 1 else "them"
        words = f"leave {bad} out of H, and fill {them} from the fit; the rest is {rest}."
        button = f"Leave {them} out"
        return Step("Next", words, button, "h.leave_out", "h", optional=v.usable)
    words = f"look at {bad}; the rest of H is {rest}."
    return Step("Next", words, "Show them", "h.worst", "h", optional=True)


def _remedy(s: Sitting) -> Step | None:
    v = s.verdict
    if v is None or v.merit != "bad" or v.remedy not in s.corrections:
        return None
    words = f"subtract the dark frames: {_short(v.cause, 40)}."
    return Step("Next", words, "Subtract them", f"frames.correct_{v.remedy}", "h")


def _why(s: Sitting) -> Step | None:
    v = s.verdict
    if v is None or v.usable:
        return None
    if v.merit == "unknown":
        words = "see why H is not fully judged."
    else:
        words = f"see why H is bad: {v.failed} of {_count(v.checks, 'check')} {'fails' if v.failed == 1 else 'fail'}."
    return Step("Next", words, "Reasons", "h.why", "h", optional=True)


def _reconstruct(s: Sitting) -> Step | None:
    if not s.light_field or s.volume or s.place != "use":
        return None
    size = " × ".join(f"{n:,}" for n in reversed(s.voxels))
    voxels = f"{size} voxels" if all(s.voxels) else "the volume"
    words = f"reconstruct {voxels}{_takes(s.reconstruct_s)}."
    return Step("Next", words, "Reconstruct", "reconstruct.start", "use")


def _export(s: Sitting) -> Step | None:
    if s.exported:
        return None
    what = "H and HT" if s.export_ht else "H"
    size = f", {format_bytes(s.export_bytes)} uncompressed" if s.export_bytes else ""
    return Step("Next", f"export {what}{size}: H is {_worth(s)}.", s.export_title, "reconstruct.export", "use")


def _exported(s: Sitting) -> Step:
    size = f", {format_bytes(s.exported_bytes)}" if s.exported_bytes else ""
    name = s.exported.replace("\\", "/").rpartition("/")[2]
    return Step("Done", f"H is exported to {_short(name, 40)}{size}.", "Show folder", "reconstruct.folder", "use")


ROWS: tuple[Callable[[Sitting], Step | None], ...] = (
    _stopped,
    _recording,
    _paused,
    _working,
    _camera,
    _camera_of_h,
    _wrong_plan,
    _assumed,
    _white,
    _unread,
    _assemble,
    _plan,
    _compute,
    _assemble_session,
    _connect,
    _disk,
    _adjust,
    _record,
    _judge,
    _few_bad,
    _remedy,
    _why,
    _reconstruct,
    _export,
    _exported,
)
"""Possible next steps in order of priority; the last one always applies."""


# -- the rail ----------------------------------------------------------------------------------------------
def rail_words(sitting: Sitting) -> dict[str, RailWords]:
    """Return the words of the rail for each of the four places."""
    return {"setup": _setup(sitting), "record": _rail_record(sitting), "h": _rail_h(sitting), "use": _use(sitting)}


def _worth(s: Sitting) -> str:
    """Return the merit of H in a word or two, as used in the rail and in the line."""
    v = s.verdict
    if v is None:
        return "not judged"
    if v.usable:
        return "good" if v.merit == "good" else "usable"
    return "bad" if v.merit == "bad" else "not fully judged"


def _setup(s: Sitting) -> RailWords:
    if not s.camera and not (s.h and s.h_camera) and s.source != "folder":
        return RailWords("no camera") if s.h else RailWords("start here", "fair")
    if s.wrong and s.needs_h and s.source != "folder":
        return RailWords("cannot work", "bad")
    if s.assumed:
        return RailWords(f"{len(s.assumed)} assumed")
    return RailWords("checked", "good") if s.white else RailWords("to check")


def _rail_record(s: Sitting) -> RailWords:
    if s.recording and not s.paused:
        return RailWords(f"plane {s.plane + 1} of {s.planes}" if s.planes else "recording")
    if s.stopped:
        return RailWords("stopped", "bad")
    if s.paused or s.unfinished:
        return RailWords("paused", "fair")
    if s.total and s.done >= s.total:
        return RailWords("complete", "good")
    if s.source == "folder":
        return RailWords("folder", "fair" if s.unread and s.needs_h else "")
    if not s.plan:
        return RailWords("needs a plan")
    if s.source == "compute":
        return RailWords("compute")
    return RailWords("ready" if s.rig else "no rig")


def _rail_h(s: Sitting) -> RailWords:
    if s.job in ("make", "compute"):
        return RailWords("being made")
    if not s.h:
        return RailWords("none yet")
    if s.job == "judge":
        return RailWords("judging")
    if s.bad:
        return RailWords(f"{s.bad:,} to redo", "fair")
    marks: dict[str, Mark] = {"good": "good", "usable": "good", "not judged": "", "bad": "bad"}
    word = _worth(s)
    return RailWords("in doubt" if word == "not fully judged" else word, marks.get(word, "fair"))


def _use(s: Sitting) -> RailWords:
    if not s.h:
        return RailWords("needs H")
    return RailWords("exported", "good") if s.exported else RailWords("ready")
