"""The table of mutants and their outcomes, for the site."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.mutants.choosing import Mutant
from tests.mutants.running import Verdict

__all__ = ["JUDGED", "page", "words_of"]

JUDGED = Path(__file__).with_name("judged.json")
"""Survivors that people have looked at, by name: why no test can tell them from the original."""


def words_of(verdict: Verdict, reason: str) -> str:
    """Return the last column of a row."""
    if verdict.how == "survived":
        return f"**survives**: {reason}" if reason else "**survives**: a test is missing"
    return "killed: it hangs" if verdict.how == "hangs" else f"killed by `{verdict.by}`"


def page(verdicts: Sequence[tuple[Mutant, Verdict]], seed: int, judged: Mapping[str, str] | None = None) -> str:
    """Return the page in Markdown."""
    reasons = json.loads(JUDGED.read_text(encoding="utf-8")) if judged is None else judged
    counted = Counter(verdict.how for _, verdict in verdicts)
    killed = len(verdicts) - counted["survived"]
    equal = sum(verdict.how == "survived" and mutant.name in reasons for mutant, verdict in verdicts)
    rows = "\n".join(
        f"| `{mutant.file.removeprefix('lfcal/')}:{mutant.mutation.line}` | {mutant.mutation.kind} | "
        f"`{_cell(mutant.mutation.before)}` → `{_cell(mutant.mutation.after)}` | "
        f"{words_of(verdict, reasons.get(mutant.name, ''))} |"
        for mutant, verdict in verdicts
    )
    return f"""# Mutants

Do the tests detect mistakes? `tests.mutants` makes one small mistake at a time in a copy of the sources. It then runs
the tests of that file (`tests/psf/test_cutout.py` for `lfcal/psf/cutout.py`), and the long ones if the quick ones pass.
A mutant that survives reveals a missing test. Of 60 new mutants each, 41, 42 and 43 were killed at first (seeds 2, 1
and 3). After the missing tests were written, 56, 58 and 56 were killed.

```sh
python -m tests.mutants                      # {len(verdicts)} mutants of seed {seed}; resumes where it stopped
python -m tests.mutants --seed 2 --list      # lists other mutants
```

**{killed} of {len(verdicts)} are killed ({100 * killed / max(1, len(verdicts)):.0f} %)**, {counted["hangs"]} of them
because the test hangs. {counted["survived"]} survive. No test can detect {equal} of these, for the reason in the table.

| line | kind | mistake | outcome |
| --- | --- | --- | --- |
{rows}
"""


def _cell(text: str, longest: int = 60) -> str:
    line = " ".join(text.split()).replace("|", "\\|").replace("`", "'")
    return line if len(line) <= longest else f"{line[: longest - 1]}…"
