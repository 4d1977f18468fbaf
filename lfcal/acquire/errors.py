"""Errors that end a session early."""

from __future__ import annotations

from lfcal.acquire.recording import Suspicion
from lfcal.base import LfcalError

__all__ = ["AcquisitionStopped", "SuspectFrame"]


class AcquisitionStopped(LfcalError):
    """The session ended early; acknowledged frames are on disk, and the session can be resumed.

    Attributes
    ----------
    acknowledged
        Number of positions whose frames are safe on disk.
    cause
        The error that ended the session, or None if the user ended it.
    """

    def __init__(self, message: str, acknowledged: int, cause: BaseException | None = None) -> None:
        super().__init__(message)
        self.acknowledged = acknowledged
        self.cause = cause


class SuspectFrame(LfcalError):
    """The content of a frame was still suspect after the frame was taken again.

    Attributes
    ----------
    what
        Suspected kinds of fault.
    """

    def __init__(self, message: str, what: Suspicion) -> None:
        super().__init__(message)
        self.what = what
