"""Self-contained HTML pages with text, tables, images and sections."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path

from lfcal import __version__
from lfcal.base.figures import COLOURS
from lfcal.base.files import write_text

__all__ = [
    "add_html_section",
    "html_figure",
    "html_page",
    "html_paragraphs",
    "html_section",
    "html_table",
    "html_text",
]

_SHEET = """
:root { --good: %(good)s; --fair: %(fair)s; --bad: %(bad)s; --unknown: %(muted)s; --muted: %(muted)s;
        --accent: %(accent)s; --line: #e5e7eb; }
* { box-sizing: border-box; }
body { font: 14px/1.45 "Segoe UI", "Helvetica Neue", Arial, "DejaVu Sans", sans-serif; color: #1f2937;
       background: #f3f4f6; margin: 0; }
main { max-width: 1120px; margin: 0 auto; padding: 24px; }
header h1 { font-size: 22px; margin: 0; overflow-wrap: anywhere; }
header p { margin: 2px 0 14px; color: var(--muted); }
section { background: #fff; border: 1px solid var(--line); border-radius: 8px; padding: 14px 18px; margin: 14px 0; }
h2 { font-size: 16px; margin: 0 0 8px; }
h3 { font-size: 14px; margin: 14px 0 4px; }
p { margin: 4px 0 8px; }
.verdict { border-left: 6px solid var(--tone); font-size: 17px; font-weight: 600; }
.verdict p { font-size: 14px; font-weight: 400; margin-bottom: 0; }
.good { --tone: var(--good); } .fair { --tone: var(--fair); } .bad { --tone: var(--bad); }
.unknown { --tone: var(--unknown); }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 10px; margin: 14px 0; }
.facts div { background: #fff; border: 1px solid var(--line); border-radius: 8px; padding: 8px 12px; }
.facts b { display: block; font-size: 17px; font-variant-numeric: tabular-nums; }
.facts span, .note, figcaption { color: var(--muted); font-size: 12.5px; }
table { border-collapse: collapse; width: 100%%; font-size: 13px; }
th { text-align: left; color: var(--muted); font-weight: 600; border-bottom: 2px solid var(--line); }
th, td { padding: 4px 10px 4px 0; vertical-align: top; }
td { border-bottom: 1px solid var(--line); }
tr:last-child td { border-bottom: 0; }
.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.nb { white-space: nowrap; }
.merit { display: inline-block; min-width: 62px; text-align: center; border-radius: 9px; padding: 0 8px; color: #fff;
         background: var(--tone); font-size: 12px; font-weight: 600; }
.advice { color: var(--tone); }
ol { margin: 4px 0; padding-left: 22px; } li { margin: 3px 0; }
figure { margin: 10px 0 0; } figure img { max-width: 100%%; height: auto; display: block; }
pre { font-size: 11.5px; white-space: pre-wrap; overflow-wrap: anywhere; background: #f9fafb; padding: 10px;
      border: 1px solid var(--line); border-radius: 6px; margin: 6px 0 0; }
footer { color: var(--muted); font-size: 12px; padding: 0 4px 20px; }
@page { size: A4; margin: 14mm 12mm; }
@media print {
  body { background: #fff; font-size: 10.5px; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  main { max-width: none; padding: 0; }
  section { border: 0; border-radius: 0; padding: 0; margin: 12px 0; }
  .verdict { border-left: 6px solid var(--tone); padding-left: 10px; }
  .facts { grid-template-columns: repeat(3, 1fr); }
  table { font-size: 9.5px; } .merit { font-size: 9px; min-width: 48px; }
  .facts span, .note, figcaption { font-size: 9.5px; } .facts b { font-size: 13px; } pre { font-size: 7.5px; }
  tr, figure, .facts div { break-inside: avoid; } h2, h3 { break-after: avoid; } thead { display: table-header-group; }
  figure img { max-height: 235mm; }
}
"""

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""Permissions of the page in a browser: show its own content, nothing else."""


def html_page(name: str, title: str, kind: str, sections: Iterable[str], footer: str) -> str:
    """Return an HTML page whose content security policy forbids scripts and external content.

    ``name`` is the main heading, and ``title`` the title of the document. The phrase ``kind`` is shown with the time
    below the heading. The text ``footer`` is at the end. The ``sections`` are HTML, which is not escaped; the others
    are text.
    """
    when = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f'<meta name="viewport" content="width=device-width"><title>{html_text(title)}</title>'
        f"<style>{_stylesheet()}</style></head>\n<body><main>\n"
        f"<header><h1>{html_text(name)}</h1><p>{html_text(kind)}, {html_text(when)}</p></header>\n"
        + "\n".join(sections)
        + f"\n<footer>lfcal {html_text(__version__)}; {html_text(footer)}.</footer>"
        "</main></body></html>\n"
    )


def html_text(value: object) -> str:
    """Return the text of a value, escaped for HTML."""
    return html.escape(str(value))


def html_section(title: str, body: str) -> str:
    """Return an HTML section with the heading ``title`` (text) and ``body`` (HTML); empty if ``body`` is empty."""
    return f"<section><h2>{html_text(title)}</h2>\n{body}</section>" if body else ""


def html_table(
    headers: Sequence[str], rows: Iterable[Iterable[str]], numeric: Iterable[int] = (), *, escape: bool = False
) -> str:
    """Return an HTML table; there is no header row if all ``headers`` (text) are empty.

    The cells of ``rows`` are HTML, or text if ``escape`` is set. The columns with the indices ``numeric`` are
    right-aligned.
    """
    if escape:
        rows = (map(html_text, row) for row in rows)
    right = set(numeric)

    def line(tag: str, cells: Iterable[str]) -> str:
        marks = (' class="n"' if k in right else "" for k in range(100))
        return "<tr>" + "".join(f"<{tag}{m}>{c}</{tag}>" for m, c in zip(marks, cells, strict=False)) + "</tr>"

    body = "\n".join(line("td", row) for row in rows)
    head = f"<thead>{line('th', map(html_text, headers))}</thead>" if any(headers) else ""
    return f"<table>{head}<tbody>\n{body}</tbody></table>\n"


def html_figure(png: bytes, caption: str) -> str:
    """Return an HTML figure: the content ``png`` of a PNG file, embedded in the page, and ``caption`` (text)."""
    data, words = base64.b64encode(png).decode("ascii"), html_text(caption)
    return f'<figure><img alt="{words}" src="data:image/png;base64,{data}"><figcaption>{words}</figcaption></figure>\n'


def html_paragraphs(lines: Iterable[str]) -> str:
    """Return each of ``lines`` (text, not empty) as an HTML paragraph with an initial capital."""
    return "".join(f"<p>{html_text(one[0].upper() + one[1:])}</p>" for one in lines)


def add_html_section(page: Path, added: str) -> None:
    """Add the section ``added`` (HTML) at the end of a file with a page of `html_page`.

    An earlier section with the same heading is removed.
    """
    body, footer, rest = page.read_text(encoding="utf-8").rpartition("\n<footer>")
    before, there, after = body.partition("\n" + added.partition("\n")[0])
    body = before + after.partition("</section>")[2] if there else body
    write_text(page, f"{body}\n{added}{footer}{rest}")


def _stylesheet() -> str:
    """Return the CSS of the page."""
    return _SHEET % COLOURS
