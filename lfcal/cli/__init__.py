"""The command line: one module per command, found by its name."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any, cast

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.cli._shared import *  # noqa: F403

__all__ = ["main"]


class _Ended(BaseException):
    """Exception for a signal that asks the program to end; it passes through every clean-up on its way out.

    It is not a KeyboardInterrupt, because the command parser would then end without a message.
    """

    def __init__(self, number: int, cause: BaseException | None = None) -> None:
        self.number = number
        for note in getattr(cause, "__notes__", ()):
            self.add_note(note)


def main(command_line: Callable[[], Any] | None = None, program: str = "lfcal") -> None:
    """Run the command line ``lfcal``.

    Invalid input ends the program with a one-line message and exit code 2. A signal ends it with exit code 128 plus the
    number of the signal.

    Parameters
    ----------
    command_line
        Function that runs the commands. None: those of lfcal. Another program may pass its own function to report
        errors in the same way.
    program
        Name of the program, as shown in its help.

    Examples
    --------
    >>> import sys
    >>> from lfcal.cli import main
    >>> sys.argv = ["lfcal", "--version"]
    >>> try:
    ...     main()
    ... except SystemExit as ended:
    ...     print("exit code", ended.code)
    lfcal ...
    exit code 0
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by a service or by >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
    try:
        with _signals_clean_up():
            _run(command_line, program)
    except _Ended as ended:
        from lfcal.cli._console import KEPT

        kept = KEPT in getattr(ended, "__notes__", ())
        said = "only complete units are kept" if kept else "no incomplete output remains"
        # the exit code that shells expect after a signal
        _stop(128 + ended.number, f"stopped; {said}")


def _run(command_line: Callable[[], Any] | None, program: str) -> None:
    # imported late: importing this package must not load every library
    import logging

    import typer

    from lfcal.base import Cancelled, LfcalError, bounded_threads, notes_to, sparing_kernels

    # matplotlib warns if a full disk cannot hold its font cache, which does not affect the result
    logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)
    # ClickException, from the click that Typer includes
    usage_error = cast(type[Exception], typer.BadParameter.__mro__[2])
    try:
        with bounded_threads(), notes_to(_report), sparing_kernels():
            from lfcal.cli import _app as app

            code = (command_line or app.command_line)()(standalone_mode=False, prog_name=program)
        sys.exit(code if isinstance(code, int) else 0)
    except usage_error as error:
        from lfcal.cli._usage import usage_line

        _stop(2, usage_line(error, sys.argv[1:]))
    except (typer.Abort, Cancelled) as error:
        raise _Ended(signal.SIGINT, error) from None
    except LfcalError as error:
        _stop(2, str(error))
    except MemoryError:
        _stop(2, "memory: not enough; choose a smaller region, or use a machine with more memory")
    except BrokenPipeError:  # the reader of the pipe has gone (head, less)
        _drop_output()
        sys.exit(1)
    except OSError as error:
        if _of_output(error):
            _drop_output()
        _stop(2, _system_words(error))


def _of_output(error: OSError) -> bool:
    """Return whether the system refused to write standard output; a missing file without a name is the folder."""
    return error.filename is None and not isinstance(error, FileNotFoundError)


def _drop_output() -> None:
    """Discard further standard output: Python's own flush at exit would fail once more."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _system_words(error: OSError) -> str:
    """Return a message on what the system refused: a long name, a missing folder, or output to a full disk."""
    from lfcal.base import StorageError

    if _of_output(error):
        where, remedy = "standard output", "check where it is written to"
    elif error.filename is None:
        where, remedy = "the current folder", "change to one that exists"
    else:
        where, remedy = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else "file", "check it"
    return str(StorageError(f"{where[:200]}: {error.strerror or error}; {remedy}"))


def _stop(code: int, message: str) -> None:
    if message:
        _report(message)
    sys.exit(code)


def _report(line: str) -> None:
    # imported late: it loads numpy, which the list of commands does not need
    from lfcal.cli._console import report

    report(line)


@contextmanager
def _signals_clean_up() -> Iterator[None]:
    """Return a context in which Ctrl-C, a hang-up or a request to terminate ends the program after its clean-up."""

    def end(number: int, _: FrameType | None) -> None:
        raise _Ended(number)

    before = {}
    if threading.current_thread() is threading.main_thread():
        # Windows has no hang-up; signals that the caller ignores (nohup) or handles itself are left unchanged
        numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
        usual = (signal.SIG_DFL, signal.default_int_handler)
        before = {number: signal.signal(number, end) for number in numbers if signal.getsignal(number) in usual}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


lazy_face(__name__)
