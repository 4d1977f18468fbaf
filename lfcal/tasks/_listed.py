"""The plan of a scan from the list of its frames that another program wrote."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.tasks.notes import note, warn
from lfcal.tasks.scan_frames import tell_size

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.camera import Camera, ScanPlan, StageAxes
    from lfcal.frames.lists import Listing

__all__ = ["plan_from_list"]


def plan_from_list(
    listed: Path,
    camera: Camera,
    *,
    folder: Path | None,
    columns: str,
    orientation: str,
    stage: StageAxes | None,
    origin: str = "",
    **settings: Any,
) -> ScanPlan:
    """Return the plan of the scan that a list was written of; frames that are found show where the light goes.

    Raises
    ------
    InputError
        If the frames are a part of the camera's sensor and ``origin`` does not say which.
    """
    from lfcal.base import StorageError
    from lfcal.frames import named_orientation, parse_origin
    from lfcal.frames.lists import Part, any_listing, located, plan_of_list, reader, sample_of

    place, turn = parse_origin(origin), named_orientation(orientation)
    listing = any_listing(listed, columns)
    root = folder or listed.parent
    try:
        listing = located(listing, root)
        shape, colour, roi = sample_of(listing, root)
        read = reader(listing, root, colour, turn)
    except StorageError as error:
        if folder is not None:
            raise
        note(f"the frames are not there to be looked at ({error}); --frames names their folder")
        read = None
    else:
        _check_size(turn.shape(shape), camera, roi, place, str(root))
        if colour is not None:
            note(f"light: of the {colour} of colour pictures; lfcal assemble takes one with --channel")
    part = None if place is None else Part(place, turn.name)
    plan, notes = plan_of_list(listing, camera, read=read, stage=stage, part=part, **settings)
    for one in notes:
        note(one)
    if read is not None and part is None:
        _tell_turned(listing, plan, read)
    return plan


def _tell_turned(listing: Listing, plan: ScanPlan, read: Callable[[int], NDArray[Any]]) -> None:
    """Report frames that are flipped or turned against the camera, which the path of their light cannot show."""
    from lfcal.base import FileFormatError, StorageError
    from lfcal.campaign import find_turned_frames, seen_patterns
    from lfcal.frames.lists import place

    try:
        seen = seen_patterns(read, place(listing, plan).positions, plan)
    except (FileFormatError, StorageError):
        return  # damaged frames are refused, or left out, where all frames are read
    found = find_turned_frames(seen, plan)
    if found is not None:
        warn(f"the frames are {found.words}; make the plan again with {found.options}, and assemble with it")


def _check_size(
    shape: tuple[int, int],
    camera: Camera,
    roi: tuple[int, int, int, int] | None,
    origin: tuple[int, int] | None,
    folder: str,
) -> None:
    """Raise where frames of ``shape`` are smaller than a sensor of known size: their place on it is not known."""
    from lfcal.frames import check_inside, is_part_of_sensor, part_refusal, stated_origin

    if origin is not None:
        check_inside(origin, shape, camera.sensor.shape)
    elif is_part_of_sensor(shape, camera):
        stated = stated_origin(roi, shape)
        raise part_refusal(shape, camera.sensor.shape, stated, "as their metadata say")
    else:
        tell_size(shape, camera, folder=folder)
