"""Assemble H from one colour of the frames, or one H file for each colour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import FileFormatError, InputError, note

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.frames import Frames

__all__ = ["ChannelPart", "coloured", "open_colour", "parts_of"]


@dataclass(frozen=True)
class ChannelPart:
    """One H file to assemble.

    ``name`` is the requested colour; it is empty if the frames are used unchanged. ``plan`` is the plan of this H,
    which may differ from the plan of the scan. ``channel`` is the channel of a mosaic; it is empty if the frames
    already have one colour.
    """

    source: Frames
    plan: ScanPlan
    channel: str
    out: Path
    name: str = ""


def coloured(out: Path, name: str) -> Path:
    """Return the H file of the colour ``name``, such as ``H_R.h5`` for ``H.h5``; unchanged if the name is empty."""
    return out.with_name(f"{out.stem}_{name}{out.suffix}") if name else out


def open_colour(opened: Callable[..., tuple[Frames, ScanPlan]], channel: str) -> tuple[Frames, ScanPlan]:
    """Return the frames and their plan; of colour images, the component ``channel`` is read (green for ``"each"``)."""
    from lfcal.frames import open_component

    try:
        return open_component(opened, channel)
    except FileFormatError as error:
        # the message names the library's argument; users of the command need the option
        raise FileFormatError(str(error).replace(' (colour="G")', ", or an H of all: --channel each")) from None


def parts_of(
    channel: str, source: Frames, plan: ScanPlan, out: Path, reopen: Callable[[str], Frames], *, quiet: bool = False
) -> list[ChannelPart]:
    """Return the H files to make from the frames.

    Parameters
    ----------
    channel
        Name of a colour, ``"each"``, or empty to use the frames unchanged.
    source, plan
        The frames, opened with the component ``channel`` (green for ``"each"``), and the plan of their scan.
    out
        H file; with ``"each"`` the colour's name is appended: ``H_R.h5``.
    reopen
        Function that opens the frames with another component.
    quiet
        Whether not to report how much of the scan each colour contains.
    """
    from lfcal.frames import COMPONENTS, ThinnedSource, colour_scan, colours_of

    component = source.metadata.colour
    names = COMPONENTS if component else colours_of(source, plan)
    wanted = list(names) if channel == "each" else [channel]
    if channel == "each" and not names:
        raise InputError.expected("--channel each", "colour frames", "monochrome ones", "leave the option out")
    parts = []
    for name in wanted:
        path = coloured(out, name if channel == "each" else "")
        if component or not name:
            parts.append(ChannelPart(source if name in ("", component) else reopen(name), plan, "", path, name))
            continue
        scan = colour_scan(source, plan, name)
        if scan is None:
            parts.append(ChannelPart(source, plan, name, path, name))
            continue
        own = ThinnedSource(source, scan)
        rows, columns = scan.plan.cutout
        if not quiet:
            note(
                f"channel {name}: {len(own)} of {len(source)} frames are used, those whose image point lies on a pixel "
                f"of this colour; period {scan.plan.period[0]} x {scan.plan.period[1]}, cutout {rows} x {columns} "
                "pixels of this colour"
            )
        parts.append(ChannelPart(own, scan.plan, name, path, name))
    return parts
