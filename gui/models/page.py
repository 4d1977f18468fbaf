"""The stages of a session, in the order of the data, and what state each is in."""

from __future__ import annotations

import importlib.util
from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from gui.models.project import SessionState

__all__ = ["STAGES", "Stage", "StageState", "available_stages", "stage_states"]


class StageState(Enum):
    """State of a stage, with the words shown for it."""

    NOTHING = "nothing yet"
    READY = "ready"
    RUNNING = "running"
    DONE = "done"
    ATTENTION = "needs attention"


@dataclass(frozen=True)
class Stage:
    """One stage of a session.

    Attributes
    ----------
    key, title
        For programs and for people.
    hint
        One sentence: what is done here.
    needs
        Library package without which the stage is left out.
    """

    key: str
    title: str
    hint: str
    needs: str


STAGES = (
    Stage("camera", "Camera", "Describe main lens, lenslets and sensor", "lfcal.camera"),
    Stage("plan", "Plan", "Choose planes and cutout; see what the scan costs", "lfcal.camera"),
    Stage("acquire", "Acquire", "Record the point source at every position", "lfcal.acquire"),
    Stage("frames", "Frames", "Import frames, clean them, cut them out", "lfcal.frames"),
    Stage("psf", "PSF", "Look at H and its transpose", "lfcal.psf"),
    Stage("quality", "Quality", "Judge the PSF and find what to record again", "lfcal.psf.quality"),
    Stage("simulate", "Simulate", "Compute the PSF of the camera as described", "lfcal.simulate"),
    Stage("reconstruct", "Reconstruct", "Turn a light field into a volume", "lfcal.reconstruct"),
    Stage("multiplex", "Multiplexing", "Compare filters, masks and lenslets", "lfcal.multiplex"),
)
"""All stages; those whose library part does not exist are left out of the window."""


def available_stages() -> tuple[Stage, ...]:
    """Return the stages whose part of the library and whose page exist."""
    return tuple(s for s in STAGES if _exists(s.needs) and _exists(f"gui.pages.{s.key}.page"))


def _exists(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def stage_states(
    state: SessionState, running: Collection[str] = (), attention: Collection[str] = ()
) -> dict[str, StageState]:
    """Return the state of every stage: a pure function of the session and of the jobs that run.

    Parameters
    ----------
    state
        The session.
    running, attention
        Keys of stages with a running job, and of stages that found something to look at.
    """
    has_psf = bool(state.psf) and Path(state.psf).exists()
    found = {
        "camera": StageState.DONE,
        "plan": StageState.DONE if state.plan is not None else StageState.READY,
        "acquire": _file_state(state.recording, state.plan is not None),
        "frames": _file_state(state.frames.folder, True),
        "psf": _file_state(state.psf, False),
        "quality": StageState.READY if has_psf else StageState.NOTHING,
        "simulate": StageState.DONE if state.reference else StageState.READY,
        "reconstruct": _file_state(state.volume, has_psf),
        "multiplex": StageState.READY,
    }
    if state.redo:
        found["acquire"] = StageState.ATTENTION
    found |= dict.fromkeys(attention, StageState.ATTENTION)
    return found | dict.fromkeys(running, StageState.RUNNING)


def _file_state(path: str, ready: bool) -> StageState:
    if path:
        return StageState.DONE if Path(path).exists() else StageState.ATTENTION
    return StageState.READY if ready else StageState.NOTHING
