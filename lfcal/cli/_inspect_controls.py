"""``lfcal inspect --session``: the control frames that a session took over the field."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import Kind, read_checks
from lfcal.base import InputError
from lfcal.judge.quality import Controls
from lfcal.psf import PSFMatrix

__all__ = ["control_frames"]


def control_frames(session: Path, H: PSFMatrix) -> Controls:
    """Return the control frames of a session, cut out like H, and where they were taken, by depth plane."""
    found: dict[int, tuple[list[NDArray[Any]], list[NDArray[Any]]]] = {}
    for check in read_checks(session):
        if check.kind != Kind.CONTROL or check.position.z >= len(H):
            continue
        # control frames may have a margin around the cutout: the same pixels as in H are compared.
        top, left = ((n - m) // 2 for n, m in zip(check.frame.shape, H.cutout, strict=True))
        # smaller frames cannot have been recorded with this H; padding them would invent light.
        if min(top, left) < 0:
            raise InputError.expected(
                "control frames",
                f"at least {H.cutout} pixels like H",
                check.frame.shape,
                "give the session that H was recorded in",
            )
        frames, places = found.setdefault(check.position.z, ([], []))
        frames.append(check.frame[top : top + H.cutout[0], left : left + H.cutout[1]])
        # where the source was, in periods from H's own cell: the tiling is tested far from it.
        places.append(np.array(H.anchor) + check.position[1:] + np.array(check.periods) * H.period)
    if not found:
        raise InputError.expected(
            f"{session}", "control frames", "none", "record with lfcal acquire --controls, or leave it out"
        )
    return {z: (np.stack(frames), np.stack(places)) for z, (frames, places) in found.items()}
