"""Check the English of changed lines: ``python -m docs_build.prose [REVISION]``.

Only lines that differ from a revision of git are checked, in pages, comments, docstrings and messages. `WORDS` lists
expressions that readers misunderstand, with their replacements. A sentence may have `LONGEST` words.
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = ["LONGEST", "WORDS", "Finding", "changed_lines", "long_sentences", "prose_of", "words_found"]

ROOT = Path(__file__).resolve().parents[1]
LONGEST = 30
"""Largest number of words in a sentence."""

WORDS = {
    r"told|tells?": "say, report, estimate, show",
    r"foret(?:ell\w*|old)": "predict, forecast",
    r"beside": "next to, compared with, besides",
    r"anew": "again",
    r"mend(?:s|ed|ing)?": "fix",
    r"nobody|somebody|whoever": "name the subject",
    r"noughts?": "zero",
    r"dearer": "more expensive, slower",
    r"(?:held|hold) against": "compare with",
    r"stands? (?:beside|for|in)": "is, represents, appears",
    r"of (?:its|their) own": "separate",
    r"by itself": "automatically, alone",
    r"goes on|went on": "continues",
    r"let go": "release",
    r"as (?:it|they) stands?": "unchanged",
    r"from which on": "threshold, above which",
}
"""Expressions to avoid, with their replacements."""

PATTERNS = {re.compile(rf"(?<!-)\b(?:{word})\b", re.IGNORECASE): instead for word, instead in WORDS.items()}
CODE = re.compile(r"`[^`]*`|https?://\S+|\]\([^)]*\)")
CHECKS_ITSELF = ("docs_build/prose.py", "tests/docs_build/test_prose.py")


@dataclass(frozen=True)
class Finding:
    """An expression to avoid, with its file, its line and its replacement."""

    file: str
    line: int
    word: str
    instead: str

    def __str__(self) -> str:
        """Return the finding as one line."""
        return f"{self.file}:{self.line}: {self.word!r}: write {self.instead}"


def words_found(text: str) -> Iterator[tuple[str, str]]:
    """Yield each expression of ``text`` to avoid, with its replacement."""
    plain = CODE.sub(" ", text)
    for pattern, instead in PATTERNS.items():
        yield from ((hit.group(0), instead) for hit in pattern.finditer(plain))


def long_sentences(text: str) -> list[str]:
    """Return the sentences of a paragraph that have more than `LONGEST` words."""
    sentences = re.split(r"(?<=[.!?:])\s+", CODE.sub(" code ", text))
    return [one for one in sentences if len(re.findall(r"[A-Za-z][A-Za-z'-]*", one)) > LONGEST]


def prose_of(path: Path) -> dict[int, str]:
    """Return the prose of a file by line: a page without its code, or the comments and texts of a program."""
    text = path.read_text(encoding="utf-8", errors="replace")
    return _prose_of_page(text) if path.suffix == ".md" else _prose_of_program(text)


def _prose_of_page(text: str) -> dict[int, str]:
    found, fenced = {}, False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        elif not fenced and not line.startswith("    "):
            found[number] = line
    return found


def _prose_of_program(text: str) -> dict[int, str]:
    kinds = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", -1)}
    found: dict[int, str] = {}
    try:
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type in kinds and (token.type == tokenize.COMMENT or " " in token.string):
                for shift, line in enumerate(token.string.splitlines()):
                    number = token.start[0] + shift
                    found[number] = f"{found.get(number, '')} {line}"
    except (tokenize.TokenError, SyntaxError):
        return {}
    return found


def changed_lines(revision: str, root: Path = ROOT) -> dict[str, set[int]]:
    """Return the numbers of the lines that were added since a revision, by file; raises `OSError` without git."""
    command = ["git", "-C", str(root), "diff", "-U0", "--no-color", revision, "--", "*.md", "*.py"]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", errors="replace")
    if done.returncode:
        raise OSError(done.stderr.strip())
    found: dict[str, set[int]] = {}
    name = ""
    for line in done.stdout.splitlines():
        if line.startswith("+++ b/"):
            name = line.removeprefix("+++ b/")
        elif hit := re.match(r"@@ -\S+ \+(\d+)(?:,(\d+))?", line):
            first, count = int(hit[1]), int(hit[2] or 1)
            found.setdefault(name, set()).update(range(first, first + count))
    return found


def findings(revision: str, root: Path = ROOT) -> list[Finding]:
    """Return the findings in the lines that were added since a revision."""
    found = []
    for name, lines in changed_lines(revision, root).items():
        path = root / name
        if name in CHECKS_ITSELF or not path.is_file():
            continue
        for number, text in prose_of(path).items():
            if number in lines:
                found += [Finding(name, number, word, instead) for word, instead in words_found(text)]
    return found


def main() -> int:
    """Print the findings; return the exit code."""
    revision = sys.argv[1] if len(sys.argv) > 1 else "HEAD~1"
    try:
        found = findings(revision)
    except OSError as error:
        print(f"prose: not checked: {error}")
        return 0
    print("\n".join(map(str, found)) or f"prose: nothing to change since {revision}")
    return int(bool(found))


if __name__ == "__main__":
    raise SystemExit(main())
