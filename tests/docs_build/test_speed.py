"""The picture of the section on speed shows what its table says."""

from __future__ import annotations

from pathlib import Path

from benchmarks import __path__ as benches
from docs_build.speed import PAGE, PICTURE, draw, ratios_of, section, short

ROW = "| a, 2 px, 3 % error | 1 | one (scipy): 31 times slower; two: over 5,000 times slower, 9 % off | `x` |"


def test_ratios_are_read_from_the_table() -> None:
    assert ratios_of(f"# Speed\n\n{ROW}\n| b | 1 | – | c |\n") == [
        ("a, 2 px, 3 % error", "one (scipy)", 31.0),
        ("a, 2 px, 3 % error", "two", 5000.0),
    ]
    assert short("a, 2 px, 3 % error") == "a, 3 % error"


def test_every_row_has_a_bar_and_a_command_that_exists(tmp_path: Path) -> None:
    text = section(PAGE.read_text(encoding="utf-8"))
    rows = [line for line in text.splitlines() if line.startswith("|")][2:]
    assert len(ratios_of(text)) == text.count("times slower") >= 7
    names = {path.stem for path in Path(next(iter(benches))).glob("*.py")}
    for row in rows:
        assert (
            "`python -m benchmarks " in row
            and row.rpartition("`python -m benchmarks ")[2].split("`")[0].split()[0] in names
        ), row
    draw(tmp_path / "speed.png")
    assert (tmp_path / "speed.png").stat().st_size > 10_000 and PICTURE.is_file()
