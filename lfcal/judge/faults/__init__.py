"""Faults by name, one family per module; `lfcal.judge.fault.FAULTS` collects them."""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.judge.faults._shared import *  # noqa: F403

lazy_face(__name__)
