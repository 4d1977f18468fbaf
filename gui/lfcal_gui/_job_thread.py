"""One running job in its own thread. No Qt."""

from __future__ import annotations

import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lfcal.base import Cancelled, InputError, LfcalError, Progress, Work, WorkAbandoned, abandonable
from lfcal_gui.models import JobLog, JobState, Keeping, Stamp, WindowJob, stamp_of, warnings_to
from lfcal_gui.workers import keep, words_of


@dataclass(frozen=True)
class JobRequest:
    """The request of a job. The job starts from it, and resumes from it after a stop.

    Attributes
    ----------
    work
        Returns the work; called in the job's thread.
    on_done, on_failed, on_end
        Called with the result on success, with the job on failure, and with the job at any end.
    before
        Called in the window's thread right before it begins.
    abandon, leave
        As in `lfcal_gui.jobs.Jobs.start`.
    at_once
        Whether the job skips the queue.
    keeping
        What is kept of its work if it ends early.
    needs
        Files that it reads, as they were when the job was requested.
    """

    work: Callable[[], Work[Any]]
    on_done: Callable[[Any], None] | None = None
    on_failed: Callable[[WindowJob], None] | None = None
    on_end: Callable[[WindowJob], None] | None = None
    before: Callable[[], None] | None = None
    abandon: bool = False
    leave: bool = False
    at_once: bool = False
    keeping: Keeping | None = None
    needs: tuple[Stamp, ...] = field(default=())

    def check(self) -> None:
        """Raise `InputError` where a file is no longer what it was when the job was asked for."""
        for stamp in self.needs:
            if stamp_of(stamp[0]) != stamp:
                name = Path(stamp[0]).name
                raise InputError.expected(
                    name, "the file as it was when this was requested", "a different file, or none", "start it again"
                )

    @staticmethod
    def stamps(paths: Iterable[str]) -> tuple[Stamp, ...]:
        """Return files as they are now; those that are not there are left to the work to refuse."""
        return tuple(found for path in paths if (found := stamp_of(path)) is not None)


class JobThread:
    """Run the work of a job, and record its progress.

    Parameters
    ----------
    number
        Number of the job.
    asked
        Its request.
    log
        Its log.
    ended
        Called with the number of the job, and the fields of the `WindowJob` that its end changes.

    Attributes
    ----------
    stop
        Set when the job must end.
    before_s
        Seconds of its finished parts.
    told
        When its progress was last reported, by the window's clock.
    """

    def __init__(
        self, number: int, asked: JobRequest, log: JobLog, ended: Callable[[int, dict[str, Any]], None]
    ) -> None:
        self.number, self.asked, self._log, self._ended = number, asked, log, ended
        self.stop = threading.Event()
        self.before_s, self.told = 0.0, 0.0
        self._newest: deque[Progress] = deque(maxlen=1)
        self.thread = threading.Thread(target=self._run, name=f"lfcal-job-{number}", daemon=True)

    def start(self) -> None:
        """Begin."""
        self.thread.start()

    def take(self) -> Progress | None:
        """Return the newest record, once."""
        try:
            return self._newest.pop()
        except IndexError:
            return None

    def _run(self) -> None:
        end: dict[str, Any]
        with warnings_to(lambda words: self._log.say("warning", words)):
            try:
                end = {"state": JobState.DONE, "result": self._follow()}
            except (Cancelled, WorkAbandoned):
                end = {"state": JobState.CANCELLED, "kept": self._kept()}
            except BaseException as error:
                keep(f"job {self.number}", error)
                trace = traceback.format_exc()
                end = {"state": JobState.FAILED, "error": words_of(error), "details": trace, "kept": self._kept()}
        self._ended(self.number, end)

    def _follow(self) -> Any:
        self.asked.check()
        running, last = self.asked.work(), 0.0
        try:
            while True:
                with abandonable(lambda: not (self.asked.leave and self.stop.is_set())):
                    record = next(running)
                self._log.follow(record)
                if self.stop.is_set():
                    raise Cancelled("stopped")
                if record.seconds < last:  # another clock
                    self.before_s += last
                last = record.seconds
                self._newest.append(record)
        except StopIteration as end:
            return end.value
        finally:
            running.close()

    def _kept(self) -> str:
        """Return what is kept of the work, once it has cleaned up behind itself."""
        try:
            return "" if self.asked.keeping is None else self.asked.keeping.look()
        except (LfcalError, OSError) as error:
            keep(f"job {self.number}", error)
            return ""
