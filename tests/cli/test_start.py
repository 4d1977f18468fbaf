"""The list of commands comes without any of their libraries, and is the one that the commands themselves give."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import pytest
import typer.main

from lfcal.cli._app import HEADINGS, build_app
from lfcal.cli._lazy import LazyCommands, listed_commands
from tests.cli.conftest import Run

HEAVY = ("numpy", "scipy", "numba", "h5py", "cv2", "matplotlib", "typer.rich_utils", "lfcal.camera", "lfcal.psf")
PROBE = """
import sys
from lfcal.cli import main
sys.argv = ["lfcal", {words}]
try:
    main()
except SystemExit:
    pass
print("loaded:", *sorted(set({heavy}) & set(sys.modules)))
"""


def loaded_by(*words: str) -> str:
    """Return what heavy modules are loaded in a new process that runs a command."""
    code = PROBE.format(words=", ".join(map(repr, words)), heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1].removeprefix("loaded:").strip()


@pytest.mark.parametrize("words", [("--help",), ("--version",)], ids=" ".join)
def test_no_library_is_loaded_for_the_list_of_commands(words: tuple[str, ...]) -> None:
    assert not loaded_by(*words)


def test_the_probe_sees_what_a_command_loads() -> None:
    assert "numpy" in loaded_by("camera", "show", "bench")


def test_the_list_is_what_the_commands_say() -> None:
    group: object = typer.main.get_command(build_app())
    commands = group.commands  # type: ignore[attr-defined]
    for listed in commands.listed.values():
        command = commands[listed.name]
        assert command.name == listed.name
        first = " ".join(str(command.help).split("\n\n")[0].split())
        assert first == listed.summary and len(listed.summary) > 20, listed


def test_every_command_of_a_heading_exists() -> None:
    named = [name for names in HEADINGS.values() for name in names]
    listed = [one.name for one in listed_commands("lfcal.cli", tuple(named))]
    assert len(named) == len(set(named)) and listed[: len(named)] == named
    assert {"bench", "status"} <= set(listed) and "console" not in listed and "camera_new" not in listed


def test_the_help_lists_every_command_under_its_heading(lfcal: Callable[..., Run]) -> None:
    said = lfcal("--help").out
    places = [said.index(f"\n{heading}\n") for heading in HEADINGS]
    assert places == sorted(places)
    assert all(f"\n  {name} " in said for names in HEADINGS.values() for name in names)
    assert "\n  bench " in said and "--install-completion" in said and "lfcal COMMAND --help" in said


def test_commands_are_a_mapping() -> None:
    commands = LazyCommands(listed_commands("lfcal.cli"))
    assert "export" in commands and "nosuch" not in commands and len(commands) == len(list(commands))
    commands["mine"] = object()
    assert list(commands)[-1] == "mine" and "mine" in commands
    del commands["mine"]
    assert "mine" not in commands


COMPLETED = {
    "commands": ("lfcal tr", {"transpose", "trend"}),
    "commands of a group": ("lfcal camera s", {"sensor", "show"}),
    "options": ("lfcal transpose --comp", {"--compression"}),
    "a compression": ("lfcal transpose H.h5 --compression z", {"zstd"}),
    "an executor": ("lfcal transpose H.h5 --executor pro", {"processes"}),
    "a preset": ("lfcal plan r2", {"r29"}),
    "a preset to simulate": ("lfcal simulate ben", {"bench"}),
    "a solver": ("lfcal reconstruct --solver si", {"sieve"}),
    "an orientation": ("lfcal assemble --orientation rot9", {"rot90"}),
    "a file": ("lfcal plan ./cam", set()),
}


@pytest.mark.parametrize("case", COMPLETED)
def test_a_shell_completes(lfcal: Callable[..., Run], monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    line, offered = COMPLETED[case]
    monkeypatch.setenv("_LFCAL_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(line.split()) - 1))
    run = lfcal()
    assert set(run.out.split()) == offered and not run.err


def test_the_script_of_a_shell_is_shown(tmp_path: object) -> None:
    env = {**os.environ, "SHELL": "/bin/bash", "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    words = [sys.executable, "-m", "lfcal", "--show-completion", "bash"]
    done = subprocess.run(words, capture_output=True, text=True, env=env)
    assert done.returncode == 0 and "_LFCAL_COMPLETE=complete_bash" in done.stdout, done.stderr
