"""How a session ends early."""

from __future__ import annotations

from lfcal.acquire.recording import Suspicion
from lfcal.base import LfcalError

__all__ = ["AcquisitionStopped", "SuspectFrame"]


class AcquisitionStopped(LfcalError):
    """The session ended early, safely: what was acknowledged is on disk and can be resumed.

    Attributes
    ----------
    acknowledged
        Positions that are safe on disk.
    cause
        The error that ended the session, or None when the user did.
    """

    def __init__(self, message: str, acknowledged: int, cause: BaseException | None = None) -> None:
        super().__init__(message)
        self.acknowledged = acknowledged
        self.cause = cause


class SuspectFrame(LfcalError):
    """The content of a frame is not what it should be, and taking it again did not help.

    Attributes
    ----------
    what
        What is suspected.
    """

    def __init__(self, message: str, what: Suspicion) -> None:
        super().__init__(message)
        self.what = what
