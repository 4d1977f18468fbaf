"""The pages are in plain English, and the check of changed lines finds what is not."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from docs_build.prose import CODE, findings, long_sentences, prose_of, words_found

ROOT = Path(__file__).parents[2]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
MOST_LONG = 0.06
"""Share of sentences that may be long."""


def paragraphs(path: Path) -> list[str]:
    """Return the paragraphs, points of lists and rows of tables of a page."""
    found: list[str] = [""]
    for line in prose_of(path).values():
        if not line.strip() or line.lstrip().startswith(("-", "|", "#", "*")):
            found.append("")
        found[-1] += f" {line.strip()}"
    return [one for one in found if one.strip() and not one.strip().startswith("|")]


def test_pages_use_no_expression_to_avoid() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {word!r}, write {instead}"
        for path in PAGES
        for number, line in prose_of(path).items()
        for word, instead in words_found(line)
    ]
    assert not found, "\n".join(found)


def test_few_sentences_of_the_pages_are_long() -> None:
    texts = [text for path in PAGES for text in paragraphs(path)]
    sentences = sum(max(1, text.count(". ") + text.count(": ")) for text in texts)
    long = [one for text in texts for one in long_sentences(text)]
    assert len(long) <= MOST_LONG * sentences, "\n".join(long)


def test_how_to_guides_are_short() -> None:
    """At most 800 words outside code."""
    guides = "camera record targets judge fit simulate views depth reconstruct multiplex matlab long_work"
    for name in guides.split():
        text = " ".join(prose_of(ROOT / "docs" / f"{name}.md").values())
        count = len(re.findall(r"[A-Za-z][A-Za-z'-]*", CODE.sub(" ", text)))
        assert count <= 800, f"{name}: {count}"


def git(folder: Path, *words: str) -> None:
    who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    subprocess.run(["git", "-C", str(folder), *who, *words], check=True, capture_output=True)


def test_only_changed_lines_are_checked(tmp_path: Path) -> None:
    page, program = tmp_path / "page.md", tmp_path / "program.py"
    page.write_text("Nobody knows.\n")
    program.write_text("told = 1\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "Begin")
    page.write_text("Nobody knows.\n\nA fault stands beside `beside`.\n\n```sh\ntells\n```\n")
    program.write_text('told = 1\nbeside = told\nprint("it goes on")  # made anew\n')
    found = {(one.file, one.line, one.word) for one in findings("HEAD", tmp_path)}
    assert found == {
        ("page.md", 3, "stands beside"),
        ("page.md", 3, "beside"),
        ("program.py", 3, "goes on"),
        ("program.py", 3, "anew"),
    }


def test_long_sentences_are_found() -> None:
    assert long_sentences("word " * 31 + ".") and not long_sentences("word " * 15 + ". " + "word " * 16 + ".")
