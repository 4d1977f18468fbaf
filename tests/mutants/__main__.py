"""Choose mutants, run their tests, and write the table: ``python -m tests.mutants``."""

from __future__ import annotations

import argparse
import json
import random
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.mutants.choosing import ROOT, choose
from tests.mutants.page import Outcome, page, words_of
from tests.mutants.running import Tree, Verdict

LEAST = 0.85
"""Least fraction of the mutants that the tests must kill before anyone looks at a survivor."""


def main() -> int:
    """Judge the selected mutants; return 1 if fewer than `LEAST` of them are killed at the first run, else 0."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, help="of the choice; by default a new one, which is printed")
    parser.add_argument("--list", action="store_true", help="only list the mutants")
    parser.add_argument("--again", metavar="TEXT", help="judge mutants again whose name contains this text")
    parser.add_argument("--place", type=Path, default=ROOT / "build" / "mutants", help="folder of the copy")
    parser.add_argument("--page", type=Path, default=ROOT / "tests" / "mutants" / "TABLE.md")
    options = parser.parse_args()
    seed = random.SystemRandom().randrange(10**6) if options.seed is None else options.seed
    print(f"seed {seed}")
    mutants = choose(options.count, seed)
    if options.list:
        for mutant in mutants:
            print(f"{mutant.mutation.kind:11} {mutant.name}")
        return 0
    options.place.mkdir(parents=True, exist_ok=True)
    memory = options.place / f"verdicts-{seed}.json"
    known: dict[str, list[dict[str, Any]]] = json.loads(memory.read_text("utf-8")) if memory.is_file() else {}
    tree = Tree(options.place / "tree")
    verdicts = []
    for k, mutant in enumerate(mutants):
        if mutant.name not in known or (options.again and options.again in mutant.name):
            # the first outcome is kept: it measures the tests before a survivor was looked at
            known[mutant.name] = [*known.get(mutant.name, [])[:1], asdict(tree.judge(mutant))]
            memory.write_text(json.dumps(known, indent=1), encoding="utf-8")
        first, last = (Verdict(**known[mutant.name][k]) for k in (0, -1))
        verdicts.append(Outcome(mutant, first, last))
        print(f"{k + 1:3} {last.seconds:5.0f} s  {mutant.name}: {words_of(last, '')}", flush=True)
    options.page.write_text(page(verdicts, seed), encoding="utf-8")
    killed = sum(one.first.how != "survived" for one in verdicts)
    print(f"{killed} of {len(verdicts)} killed at first")
    return int(killed < LEAST * len(verdicts))


if __name__ == "__main__":
    sys.exit(main())
