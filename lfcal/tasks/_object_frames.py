"""Read ordinary frames, whose objects are unknown, in the orientation and pixels of the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from lfcal.records import CorrectionRecipe, opt, read_orientation
from lfcal.tasks._patterns import NO_PLACE, check_colours, own_words

if TYPE_CHECKING:
    from datetime import datetime

    from lfcal.camera import ScanPlan
    from lfcal.fit import NewFrame
    from lfcal.frames import FolderSource, FrameSource

__all__ = ["ObjectFrameReading", "ObjectFrames", "channel_field", "turn_field", "windows_field"]


def _turns() -> tuple[str, ...]:
    from lfcal.frames import ORIENTATIONS

    return tuple(one.option for one in ORIENTATIONS.values())


def turn_field() -> str:
    """Declare the field ``orientation`` of a task that reads frames of unknown objects."""
    return opt(
        "as-is",
        "How to turn the frames upright: as-is, rot90, rot180, rot270 (anticlockwise), mirror-x (left to right), "
        "mirror-y, transpose, anti-transpose. Frames of unknown objects do not show their orientation.",
        choices=_turns,
        read=read_orientation,
    )


def channel_field() -> str:
    """Declare the field ``channel`` of a task that reads frames of unknown objects."""
    return opt(
        "",
        "Colour channel to use: R, G1, G2 or B of a mosaic; R, G or B of a colour image.",
        examples=("R", "G", "B", "G1", "G2"),
        empty="frames are used unchanged",
    )


def windows_field(use: str) -> int | None:
    """Declare the field ``windows`` of a task that explains frames; ``use`` says what happens in the windows."""
    return opt(
        None,
        f"Number of windows of the sensor {use}.",
        at_least=1,
        at_most=5,
        empty="one; five for a large sensor",
        more=True,
    )


class ObjectFrames(Sequence["NewFrame"]):
    """Frames that are read when they are needed, and their recording times, as far as these are known.

    Parameters
    ----------
    views, times
        Corrected frames of several files or folders, and the times of their frames.
    """

    def __init__(self, views: Sequence[FrameSource], times: Sequence[datetime | None] = ()) -> None:
        self.times = tuple(times)
        self._places = [(view, k) for view in views for k in range(len(view))]

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._places)

    @overload
    def __getitem__(self, k: int) -> NewFrame: ...
    @overload
    def __getitem__(self, k: slice) -> list[NewFrame]: ...
    def __getitem__(self, k: int | slice) -> NewFrame | list[NewFrame]:
        """Read a frame, or several."""
        from lfcal.judge import new_frame

        if isinstance(k, slice):
            return [self[n] for n in range(len(self))[k]]
        view, number = self._places[k]
        with own_words(without=NO_PLACE):
            return new_frame(view, number, view.info(number).label)


@dataclass(frozen=True)
class ObjectFrameReading:
    """Settings for reading frames of unknown objects.

    Attributes
    ----------
    plan
        Scan plan, which contains the camera.
    orientation, channel, recipe
        Operation that turns the frames upright, colour channel, and corrections.
    """

    plan: ScanPlan
    orientation: str
    channel: str
    recipe: CorrectionRecipe

    def frames(self, paths: Sequence[Path], stack: ExitStack) -> ObjectFrames:
        """Return the frames of files and folders, in order."""
        from lfcal.frames import recorded_times

        views: list[Any] = []
        times: list[datetime | None] = []
        for path in paths:
            source, view = self._opened(path, stack)
            views.append(view)
            times += recorded_times(source)
        return ObjectFrames(views, times)

    def _opened(self, path: Path, stack: ExitStack) -> tuple[FolderSource, FrameSource]:
        """Return the files of a path, and their corrected frames in the orientation of the sensor."""
        from lfcal.frames import check_turned_colours, named_orientation, open_component, open_unplaced, oriented

        plan, sources = self.plan, []

        def opened(colour: str | None = None) -> FolderSource:
            sources.append(stack.enter_context(open_unplaced(path, colour)))
            return sources[-1]

        with own_words(without=NO_PLACE):
            frames = open_component(opened, self.channel)
            turn = named_orientation(self.orientation)
            check_turned_colours(frames, plan, replace(self.recipe, channel=self.channel), turn.name)
            return sources[-1], oriented(self._corrected(path, frames), turn, plan.camera.sensor.shape)

    def _corrected(self, path: Path, frames: FrameSource) -> FrameSource:
        """Return the corrected frames; of a mosaic, only the pixels of the channel are valid.

        If H was assembled from a channel, the pixels of its camera are those of the channel.
        """
        from lfcal.frames import OneColourSource, colours_of, corrected_view

        if frames.metadata.colour:
            return corrected_view(frames, self.recipe, self.plan)
        if not self.channel:
            check_colours(path, frames, self.plan, lambda colours: f"choose one of them (--channel {colours[0]})")
            return corrected_view(frames, self.recipe, self.plan)
        if colours_of(frames, self.plan) and frames.shape != self.plan.camera.sensor.shape:
            return corrected_view(frames, replace(self.recipe, channel=self.channel), self.plan)
        return OneColourSource(corrected_view(frames, self.recipe, self.plan), self.channel, self.plan)
