"""Usage errors of the command line: suggestions, and options that would have no effect."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError

if TYPE_CHECKING:
    import typer

__all__ = ["refuse", "usage_line"]


def _moved(command: str, now: str, *options: str) -> dict[tuple[str, str], str]:
    return {(command, option): f"{now} {option}" for option in options}


FIT, TARGET = "lfcal plan fit PLAN --count N", "lfcal plan target PLAN SOURCE"

RENAMED: dict[tuple[str, str], str] = {
    ("lfcal reconstruct", "--batch"): "lfcal reconstruct H FRAMES",
    ("lfcal reconstruct", "--as-is"): "--resample never",
    ("lfcal plan", "--for-fit"): FIT,
    ("lfcal plan", "--beside"): f"{FIT} --position-error",
    **_moved("lfcal plan", FIT, "--candidates", "--draw", "--from", "--full", "--unknowns"),
    ("lfcal plan fit", "--for-fit"): "--count",
    ("lfcal plan fit", "--list"): "--out",
    ("lfcal plan fit", "--beside"): "--position-error",
    ("lfcal plan", "--source"): TARGET,
    **_moved("lfcal plan", TARGET, "--crosstalk", "--most-frames", "--patterns", "--pose", "--pose-within"),
    **_moved("lfcal plan", TARGET, "--signal", "--tolerance"),
    ("lfcal plan target", "--source"): TARGET,
    ("lfcal fit", "--check"): "lfcal fit check OLD.h5 FRAMES",
    ("lfcal fit", "--limit"): "lfcal fit check OLD.h5 FRAMES --limit 2%",
    ("lfcal fit", "--validate"): "lfcal fit SOURCE -o fit, then lfcal fit validate fit SOURCE",
    ("lfcal fit", "--validate-on"): "lfcal fit SOURCE -o fit, then lfcal fit validate fit OTHER --other",
    ("lfcal fit", "--object"): "lfcal fit SOURCE -o fit, then lfcal fit object fit FRAME --scene VOLUME",
    ("lfcal fit", "--scene"): "lfcal fit SOURCE -o fit, then lfcal fit object fit FRAME --scene VOLUME",
    ("lfcal fit", "--effects"): "--effect, once for each",
}
"""Replacement for an option, by the words of the command and the option."""


def refuse(context: typer.Context, wanted: str, got: str, *names: str) -> None:
    """Raise `InputError` if an option of the parameters ``names`` was given, but has no effect here.

    ``wanted`` is the input to which the options apply, and ``got`` the actual input.
    """
    for one in context.command.params:
        source = context.get_parameter_source(str(one.name))
        if one.name in names and source is not None and source.name == "COMMANDLINE":
            option = max(one.opts, key=len)
            raise InputError.expected(option, wanted, got, f"leave {option} out")


def usage_line(error: Any, words: Sequence[str]) -> str:
    """Return the message for a usage error of the command parser; empty if its help has been printed.

    ``words`` contains the command line as typed.
    """
    context = getattr(error, "ctx", None)
    unknown = getattr(error, "option_name", None)
    missing = unknown is not None and hasattr(error, "possibilities")
    said = str(error.message if missing else error.format_message()).rstrip(".")
    if not said or context is None:
        return said
    now = RENAMED.get((context.command_path, str(unknown)))
    if now is not None:
        return f"{unknown}: expected an option of {context.command_path}; use {now}"
    if missing and (meant := nearest_option(str(unknown), words, context.command.params)):
        said += f". Did you mean {meant}?"
    name = context.command_path.split()[-1]
    if type(error).__name__ == "MissingParameter" and Path(name).is_dir():
        return f"{said}; see {context.command_path} --help. To use the folder {name}, type {name}/"
    return f"{said}{' See' if said.endswith('?') else '; see'} {context.command_path} --help"


def nearest_option(unknown: str, words: Sequence[str], parameters: Sequence[Any]) -> str:
    """Return the option that was probably meant, or an empty string.

    A long name after one dash is parsed as letters, the first of which is unknown: `-force` means `--force`.
    """
    names = [name for one in parameters for name in (*one.opts, *one.secondary_opts) if name.startswith("--")]
    if not unknown.startswith("--"):
        typed = [word.partition("=")[0] for word in words if word.startswith("-") and not word.startswith("--")]
        long = [f"-{word}" for word in typed if unknown[-1] in word and len(word) > 2]
        close = [match for word in long for match in get_close_matches(word, names, 1, 0.8)]
    else:
        close = get_close_matches(unknown.partition("=")[0], names, 1)
    return close[0] if close else ""
