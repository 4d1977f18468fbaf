"""The list of commands, their help, completion, misspelt words, and the progress bar."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

from lfcal.base.progress import Progress, Work
from lfcal.cli._app import HEADINGS, build_app, command_line
from lfcal.cli._console import done_text, print_json, run_work
from lfcal.cli._lazy import listed_commands
from tests.cli.conftest import Lfcal, Run
from tests.cli.test_options import walk

# -- The list of commands comes without any of their libraries, and is the one that the commands themselves give --
HEAVY = ("numpy", "scipy", "numba", "h5py", "cv2", "matplotlib", "typer.rich_utils", "lfcal.camera", "lfcal.psf")
PROBE = """
import sys
from lfcal.cli import main
for words in {words}:
    sys.argv = ["lfcal", *words]
    try:
        main()
    except SystemExit:
        pass
    print("loaded:", *sorted(set({heavy}) & set(sys.modules)))
"""


def test_no_library_is_loaded_for_the_list_of_commands() -> None:
    words = (["--help"], ["--version"], ["camera", "show", "bench"])
    command = [sys.executable, "-c", PROBE.format(words=words, heavy=HEAVY)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = [line.removeprefix("loaded:").split() for line in done.stdout.splitlines() if line.startswith("loaded:")]
    assert loaded[:2] == [[], []] and "numpy" in loaded[2], "the last one shows that the probe works"


def test_the_help_lists_every_command_under_its_heading(lfcal: Lfcal) -> None:
    commands = typer.main.get_command(build_app()).commands  # type: ignore[attr-defined]
    for listed in commands.listed.values():
        command = commands[listed.name]
        first = " ".join(str(command.help).split("\n\n")[0].split())
        assert command.name == listed.name and first == listed.summary and len(listed.summary) > 20, listed
    named = [name for names in HEADINGS.values() for name in names]
    listed = [one.name for one in listed_commands("lfcal.cli", tuple(named))]
    assert len(named) == len(set(named)) and listed[: len(named)] == named
    assert {"bench", "status"} <= set(listed) and "console" not in listed and "camera_new" not in listed
    said = lfcal("--help").out
    places = [said.index(f"\n{heading}\n") for heading in HEADINGS]
    assert places == sorted(places) and all(f"\n  {name} " in said for name in named)
    assert "\n  bench " in said and "--install-completion" in said and "lfcal COMMAND --help" in said
    bare = lfcal()
    assert bare.code == 2 and "Usage: lfcal" in bare.out and not bare.err


COMPLETED: dict[str, set[str]] = {
    "lfcal tr": {"transpose", "trend"},
    "lfcal camera s": {"sensor", "show"},
    "lfcal transpose --comp": {"--compression"},
    "lfcal transpose H.h5 --compression z": {"zstd"},
    "lfcal transpose H.h5 --executor pro": {"processes"},
    "lfcal plan r2": {"r29"},
    "lfcal simulate ben": {"bench"},
    "lfcal reconstruct --solver si": {"sieve"},
    "lfcal assemble --orientation rot9": {"rot90"},
    "lfcal plan ./cam": set(),
}


def test_a_shell_completes(lfcal: Lfcal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_LFCAL_COMPLETE", "complete_bash")
    for line, offered in COMPLETED.items():
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(line.split()) - 1))
        run = lfcal()
        assert set(run.out.split()) == offered and not run.err, line


# -- A command line that is wrong ends in one line that says where the right one is described --
WRONG = (
    ("nosuch", "No such command 'nosuch'; see lfcal --help"),
    ("transpose H.h5 --nosuch", "No such option: --nosuch"),
    ("plan bench --average abc", "--average: expected a whole number ≥ 1, got 'abc'"),
    ("export", "Missing argument 'SOURCE'; see lfcal export --help"),
    ("export H.h5 -o", "Option '-o' requires an argument"),
    ("transpose H.h5 -force", "Did you mean --force? See lfcal transpose"),
    ("transpose H.h5 -q", "No such option: -q; see lfcal transpose --help"),
    ("camera show benhc", "did you mean bench?"),
    ("transpose H.h5 -o a.h5 --workers 0", "--workers: expected a whole number ≥ 1"),
)


def test_a_wrong_command_line_ends_in_one_line(lfcal: Lfcal) -> None:
    for words, said in WRONG:
        run = lfcal(*words.split())
        assert run.code == 2 and said in run.err and len(run.err.splitlines()) == 1 and not run.out, words


# -- What every command has: JSON where a script reads it, an example that would run, and an answer to a typo --
EVERY = {" ".join(path): command for path, command in walk(command_line())}
GROUPS = {name: command for name, command in EVERY.items() if hasattr(command, "commands")}
COMMANDS = {name: command for name, command in EVERY.items() if name not in GROUPS}


def long_options(command: Any) -> list[str]:
    return [name for one in command.params for name in one.opts if name.startswith("--")]


def examples(command: Any) -> list[str]:
    """Return the command lines that the last paragraph of a command's help shows."""
    said = str(command.epilog or str(command.help).rstrip().rpartition("\n\n")[2])
    return re.findall(r"`(lfcal [^`]+)`", said) if said.startswith("Example: ") else []


def parsed(words: list[str]) -> tuple[str, dict[str, Any]]:
    """Return the command that words call, and its parameters; raises what its parser says of them."""
    command, name = command_line(), ""
    context = command.make_context("lfcal", list(words))
    while name not in COMMANDS:
        word, command, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        name = f"{name} {word}".strip()
        context = command.make_context(word, rest, parent=context)
    # a command with others behind its name has made the context of the one that was named
    return context.command_path.partition(" ")[2], context.params


def test_every_command_prints_json_and_understands_its_examples() -> None:
    assert {"fit", "camera show", "bench", "multiplex coding"} <= set(COMMANDS)
    assert set(GROUPS) == {"", "camera", "multiplex"}
    for name, command in COMMANDS.items():
        lines = examples(command)
        assert lines, f"{name}: the help ends with Example: `lfcal …`"
        assert "--json" in long_options(command), f"{name}: add json: JsonOption"
        for line in lines:
            called, parameters = parsed(shlex.split(line)[1:])
            assert called == name and parameters, line
    for name, group in GROUPS.items():
        for line in (found := examples(group)):
            called, _ = parsed(shlex.split(line)[1:])
            assert called.startswith(f"{name} ") and line in examples(COMMANDS[called])
        assert found or not name, name


def test_json_is_strict(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"none": float("nan"), "endless": [float("inf"), 1.0], "path": Path("H.h5")})
    assert json.loads(capsys.readouterr().out) == {"none": None, "endless": [None, 1.0], "path": "H.h5"}
    with pytest.raises(ValueError, match="not strict JSON: NaN"):
        _ = Run(0, '{"error": NaN}', "").json


def misspelt(word: str) -> str:
    """Return a word with the letter in its middle doubled."""
    middle = len(word) // 2
    return word[: middle + 1] + word[middle:]


def test_a_misspelt_option_or_command_is_answered_with_the_one_that_was_meant(lfcal: Lfcal) -> None:
    for name, command in COMMANDS.items():
        option = max(long_options(command), key=len)
        run = lfcal(*name.split(), misspelt(option))
        assert run.code == 2 and f"Did you mean {option}? See lfcal {name} --help" in run.err and not run.out, name
    for name, group in GROUPS.items():
        for word in group.commands:
            lfcal(*name.split(), misspelt(word)).refused(f"Did you mean '{word}'")


# -- What long work says while it runs: on a terminal, and nothing in a pipe --
class Terminal(io.StringIO):
    """A terminal that keeps what is written."""

    def isatty(self) -> bool:
        return True


def planes(count: int) -> Work[str]:
    def work() -> Iterator[Progress]:
        for k in range(count):
            yield Progress(k + 1, count, "planes", note=f"plane {k}")

    yield from work()
    return "done"


def test_how_far_and_how_fast() -> None:
    for record, speed, said in (
        (Progress(3, 40, "planes"), None, "3 of 40"),
        (Progress(3, 40, "planes"), 0.0, "3 of 40"),
        (Progress(3, 40, "planes"), 12.345, "3 of 40, 12.3/s"),
        (Progress(3, 40, "planes"), 0.5, "3 of 40, 30/min"),
        (Progress(3, 40, "planes"), 0.001, "3 of 40, 3.6/h"),
        (Progress(3, 0, "frames"), 2.0, "3, 2/s"),
        # a run of few long units moves in thousandths of them
        (Progress(1500, 4000, "units", per=1000), 100.0, "1 of 4, 6/min"),
    ):
        assert done_text(record, speed) == said


def test_a_bar_is_shown_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    for quiet, written, shown in ((False, Terminal(), True), (True, Terminal(), False), (False, io.StringIO(), False)):
        monkeypatch.setattr("sys.stderr", written)
        assert run_work(planes(8), quiet=quiet) == "done"
        said = written.getvalue()
        assert all((word in said) == shown for word in ("planes", "8 of 8", "left", "plane 7")) and bool(said) == shown


def test_the_script_of_a_shell_is_shown() -> None:
    env = {**os.environ, "SHELL": "/bin/bash", "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    words = [sys.executable, "-m", "lfcal", "--show-completion", "bash"]
    done = subprocess.run(words, capture_output=True, text=True, env=env)
    assert done.returncode == 0 and "_LFCAL_COMPLETE=complete_bash" in done.stdout, done.stderr
