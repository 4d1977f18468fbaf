"""Make mutants, run their tests, write the table: ``python -m tests.mutants``."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from tests.mutants.choosing import ROOT, choose
from tests.mutants.page import page, words_of
from tests.mutants.running import Tree, Verdict


def main() -> int:
    """Judge the mutants that are asked for; return the exit code: 1 where fewer than 9 of 10 are killed."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--list", action="store_true", help="only show them")
    parser.add_argument("--again", metavar="TEXT", help="judge those anew whose name contains this")
    parser.add_argument("--place", type=Path, default=ROOT / "build" / "mutants", help="where the copy lives")
    parser.add_argument("--page", type=Path, default=ROOT / "tests" / "mutants" / "TABLE.md")
    options = parser.parse_args()
    mutants = choose(options.count, options.seed)
    if options.list:
        for mutant in mutants:
            print(f"{mutant.mutation.kind:11} {mutant.name}")
        return 0
    options.place.mkdir(parents=True, exist_ok=True)
    memory = options.place / f"verdicts-{options.seed}.json"
    known = json.loads(memory.read_text(encoding="utf-8")) if memory.is_file() else {}
    tree = Tree(options.place / "tree")
    verdicts = []
    for k, mutant in enumerate(mutants):
        if mutant.name not in known or (options.again and options.again in mutant.name):
            known[mutant.name] = asdict(tree.judge(mutant))
            memory.write_text(json.dumps(known, indent=1), encoding="utf-8")
        verdict = Verdict(**known[mutant.name])
        verdicts.append((mutant, verdict))
        print(f"{k + 1:3} {verdict.seconds:5.0f} s  {mutant.name}: {words_of(verdict, '')}", flush=True)
    options.page.write_text(page(verdicts, options.seed), encoding="utf-8")
    killed = sum(verdict.how != "survived" for _, verdict in verdicts)
    print(f"{killed} of {len(verdicts)} killed")
    return int(killed < 0.9 * len(verdicts))


if __name__ == "__main__":
    sys.exit(main())
