"""Commands and examples of the pages: every command exists, and a tutorial shows what it prints and draws."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from docs_build.running import LONGEST, TutorialError, run_page, runs
from lfcal.cli import main
from lfcal.cli._app import command_line

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(r"^```(?:sh|text)(?: run[^\n]*)?\n(.*?)^```", re.MULTILINE | re.DOTALL)


def commands_of(page: Path) -> Iterator[list[str]]:
    """Yield the words of every ``lfcal`` command of a page."""
    for block in BLOCK.findall(page.read_text(encoding="utf-8")):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True) if line.lstrip().startswith(("lfcal ", "uv run lfcal ")) else []
            found: list[list[str]] = [[]]
            for word in words:
                if word in ("&&", "|", ";"):
                    found.append([])
                else:
                    found[-1].append(word)
            yield from (one[one.index("lfcal") :] for one in found if "lfcal" in one)


def test_every_command_and_option_of_the_pages_exists() -> None:
    whole: Any = command_line()
    for page in sorted(DOCS.rglob("*.md")):
        for words in commands_of(page):
            if "COMMAND" in words or words[1].startswith("-"):
                continue
            entered, rest = whole, words[1:]
            while getattr(entered, "commands", None):
                assert rest[0] in entered.commands, f"{page.name}: {words}"
                entered = entered.commands[rest.pop(0)]
            if rest and rest[0] in (getattr(entered, "parts", None) or {}):
                entered = entered.parts[rest.pop(0)]
            if "--help" not in rest:
                entered.make_context(f"lfcal in {page.name}", rest)


@pytest.mark.long
def test_the_example_of_fourier_microscopes_makes_a_volume_with_the_bead(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    example = BLOCK.findall((DOCS / "fourier.md").read_text(encoding="utf-8"))[0]
    monkeypatch.chdir(tmp_path)
    for line in example.splitlines():
        monkeypatch.setattr("sys.argv", shlex.split(line))
        with pytest.raises(SystemExit) as stop:
            main()
            raise SystemExit(0)
        # inspect returns 1 where H has a fault; a simulated one has none
        assert not stop.value.code, line
    volume = tifffile.imread(tmp_path / "volume.tif")
    # one volume for each depth of the bead, or the planes of a single one
    volumes = volume.reshape(-1, 5, *volume.shape[-2:])
    assert np.isfinite(volumes).all() and volumes.max() > 0
    for z, one in enumerate(volumes):
        where = np.unravel_index(int(one.argmax()), one.shape)
        assert len(volumes) == 1 or where[0] == z
        assert np.abs(np.array(where[1:]) - (np.array(one.shape[1:]) - 1) / 2).max() <= 2


# -- tutorials ---------------------------------------------------------------------------------------------


PAGE = """# A page

```python run
a = 20
print(f"{a + 3} counts")
```

Text.

```python run
from pathlib import Path

Path("drawn.png").write_bytes(b"picture")
```

![A picture](drawn.png) and ![another](there.png) and ![elsewhere](https://x.org/a.png)

```python
never run
```
"""


def test_output_is_below_its_block_and_names_are_kept(tmp_path: Path) -> None:
    ran = run_page(PAGE, tmp_path, lambda name: name == "there.png")
    assert '```python\na = 20\nprint(f"{a + 3} counts")\n```\n\n```text\n23 counts\n```\n' in ran.markdown
    assert "run\n" not in ran.markdown.replace("never run\n", "") and "```python\nnever run\n```" in ran.markdown
    assert ran.pictures == {"drawn.png": b"picture"}
    assert runs(PAGE) and not runs("```python\nx = 1\n```\n```sh\nlfcal\n```\n")
    long = run_page("```python run\nfor k in range(100): print('line', k)\n```\n", tmp_path)
    lines = long.markdown.split("```text\n")[1].splitlines()
    assert lines[0] == "line 0" and "…" in lines and "line 99" in lines and len(lines) == LONGEST + 2


def test_commands_are_run_line_by_line_and_only_the_last_may_fail(tmp_path: Path) -> None:
    page = "```sh run\necho one \\\n  two\n```\n```sh run fails=2\nlfcal --version   # which\nlfcal nosuch\n```\n"
    ran = run_page(page, tmp_path)
    assert ran.markdown.split("```text\n")[1].startswith("one two\n```")
    assert ran.markdown.split("```text\n")[2].startswith("lfcal ") and "No such command" in ran.markdown


@pytest.mark.parametrize(
    ("page", "message"),
    [
        ("```python run\n1 / 0\n```\n", "ZeroDivisionError"),
        ("```sh run\nlfcal nosuch\n```\n", "exit code 2, not 0"),
        ("```sh run fails=2\nlfcal --version\n```\n", "exit code 0, not 2"),
        ("```sh run fails=2\nlfcal nosuch\nlfcal --version\n```\n", "exit code 2, not 0"),
        ("![Never drawn](never.png)\n```python run\npass\n```\n", "never.png: the page shows this picture"),
    ],
)
def test_a_page_that_does_not_do_what_it_says_is_an_error(tmp_path: Path, page: str, message: str) -> None:
    with pytest.raises(TutorialError, match=message):
        run_page(page, tmp_path)
