"""The table of mutants and their outcomes, for the site."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.choosing import Mutant
from tests.mutants.running import Verdict

__all__ = ["JUDGED", "Outcome", "page", "words_of"]

JUDGED = Path(__file__).with_name("judged.json")
"""Equivalent mutants by name, with the reason why no test can detect them."""


def words_of(verdict: Verdict, reason: str) -> str:
    """Return the last column of a row."""
    if verdict.how == "survived":
        return f"**survives**: {reason}" if reason else "**survives**: a test is missing"
    return "killed: it hangs" if verdict.how == "hangs" else f"killed by `{verdict.by}`"


@dataclass(frozen=True)
class Outcome:
    """A mutant, its first outcome, and its outcome with the tests that were written later."""

    mutant: Mutant
    first: Verdict
    last: Verdict


def page(outcomes: Sequence[Outcome], seed: int, judged: Mapping[str, str] | None = None) -> str:
    """Return the page in Markdown; ``judged`` contains the reasons why no test can detect a mutant, by its name."""
    reasons = json.loads(JUDGED.read_text(encoding="utf-8")) if judged is None else judged
    count = max(1, len(outcomes))
    first, last = (
        sum(one.how != "survived" for one in some) for some in zip(*((o.first, o.last) for o in outcomes), strict=True)
    )
    equal = sum(one.last.how == "survived" and one.mutant.name in reasons for one in outcomes)
    rows = "\n".join(_row(one.mutant, one.last, reasons.get(one.mutant.name, "")) for one in outcomes)
    return f"""# Mutants

Do the tests detect mistakes? `tests.mutants` makes one small mistake at a time in a copy of the sources. It then runs
the tests that belong to the file, and the long ones if the quick ones pass. A mutant that survives reveals a missing
test, unless it is equivalent to the original. Each run draws new mutants; `--seed` resumes a run or lists its mutants.

```sh
python -m tests.mutants                      # {len(outcomes)} new mutants
python -m tests.mutants --seed {seed} --list      # the mutants of this table
```

**The tests killed {first} of {len(outcomes)} mutants ({100 * first / count:.0f} %) at the first run.** With the tests
that were written since, they kill {last}. No test can detect {equal} of the others, for the reason in the table.

| line | kind | mistake | outcome |
| --- | --- | --- | --- |
{rows}
"""


def _row(mutant: Mutant, verdict: Verdict, reason: str) -> str:
    one = mutant.mutation
    return (
        f"| `{mutant.file.removeprefix('lfcal/')}:{one.line}` | {one.kind} | "
        f"`{_cell(one.before)}` → `{_cell(one.after)}` | {words_of(verdict, reason)} |"
    )


def _cell(text: str, longest: int = 60) -> str:
    line = " ".join(text.split()).replace("|", "\\|").replace("`", "'")
    return line if len(line) <= longest else f"{line[: longest - 1]}…"
