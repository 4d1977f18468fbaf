"""A command line that is wrong ends in one line that says where the right one is described."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.cli.conftest import Run

WRONG = {
    "no such command": (("nosuch",), "No such command 'nosuch'; see lfcal --help"),
    "no such option": (("transpose", "H.h5", "--nosuch"), "No such option: --nosuch"),
    "another type": (("plan", "bench", "--average", "abc"), "--average: expected a whole number ≥ 1, got 'abc'"),
    "an argument missing": (("export",), "Missing argument 'SOURCE'; see lfcal export --help"),
    "an option without its value": (("export", "H.h5", "-o"), "Option '-o' requires an argument"),
    "a command misspelt": (("asemble",), "No such command 'asemble'. Did you mean 'assemble'? See lfcal --help"),
    "a command of a group misspelt": (("camera", "sho"), "Did you mean 'show'? See lfcal camera --help"),
    "an option misspelt": (("transpose", "H.h5", "--compresion", "gzip"), "Did you mean --compression? See lfcal tran"),
    "a long option behind one dash": (("transpose", "H.h5", "-force"), "Did you mean --force? See lfcal transpose"),
    "a letter that no option has": (("transpose", "H.h5", "-q"), "No such option: -q; see lfcal transpose --help"),
    "a preset misspelt": (("camera", "show", "benhc"), "did you mean bench?"),
    "a number out of range": (
        ("transpose", "H.h5", "-o", "a.h5", "--workers", "0"),
        "--workers: expected a whole number ≥ 1",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_one_line(lfcal: Callable[..., Run], case: str) -> None:
    words, said = WRONG[case]
    run = lfcal(*words)
    assert run.code == 2 and said in run.err and len(run.err.splitlines()) == 1 and not run.out


def test_without_a_command_there_is_help(lfcal: Callable[..., Run]) -> None:
    run = lfcal()
    assert run.code == 2 and "Usage: lfcal" in run.out and not run.err
