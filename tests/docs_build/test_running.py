"""A tutorial shows what it really prints and draws, and a page that fails stops the build."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs_build.running import LONGEST, TutorialError, run_page, runs

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


def test_output_stands_below_its_block_and_names_live_on(tmp_path: Path) -> None:
    ran = run_page(PAGE, tmp_path, lambda name: name == "there.png")
    assert '```python\na = 20\nprint(f"{a + 3} counts")\n```\n\n```text\n23 counts\n```\n' in ran.markdown
    assert "run\n" not in ran.markdown.replace("never run\n", "") and "```python\nnever run\n```" in ran.markdown
    assert ran.pictures == {"drawn.png": b"picture"}


def test_commands_are_run_line_by_line(tmp_path: Path) -> None:
    page = "```sh run\nlfcal --version   # which\necho one \\\n  two\n```\n"
    ran = run_page(page, tmp_path)
    said = ran.markdown.split("```text\n")[1]
    assert said.startswith("lfcal ") and "one two\n```" in said


@pytest.mark.parametrize(
    ("page", "said"),
    [
        ("```python run\n1 / 0\n```\n", "ZeroDivisionError"),
        ("```sh run\nlfcal nosuch\n```\n", "exit code 2, not 0"),
        ("```sh run fails=2\nlfcal --version\n```\n", "exit code 0, not 2"),
        ("![Never drawn](never.png)\n```python run\npass\n```\n", "never.png: shown"),
    ],
)
def test_a_page_that_does_not_do_what_it_says_is_an_error(tmp_path: Path, page: str, said: str) -> None:
    with pytest.raises(TutorialError, match=said):
        run_page(page, tmp_path)


def test_only_the_last_line_may_be_meant_to_fail(tmp_path: Path) -> None:
    ran = run_page("```sh run fails=2\nlfcal --version\nlfcal nosuch\n```\n", tmp_path)
    assert "No such command" in ran.markdown
    with pytest.raises(TutorialError):
        run_page("```sh run fails=2\nlfcal nosuch\nlfcal --version\n```\n", tmp_path)


def test_long_output_loses_its_middle(tmp_path: Path) -> None:
    ran = run_page("```python run\nfor k in range(100): print('line', k)\n```\n", tmp_path)
    lines = ran.markdown.split("```text\n")[1].splitlines()
    assert lines[0] == "line 0" and "…" in lines and "line 99" in lines and len(lines) == LONGEST + 2


def test_pages_without_anything_to_run(tmp_path: Path) -> None:
    assert runs(PAGE) and not runs("```python\nx = 1\n```\n```sh\nlfcal\n```\n")
