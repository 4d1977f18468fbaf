"""What pages for people are made of: HTML that needs nothing from outside."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from datetime import datetime

from lfcal import __version__
from lfcal.psf.report._pictures import ReportPicture
from lfcal.psf.report.style import stylesheet

__all__ = ["document", "figures", "section", "table", "text"]

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""What a browser may do for this page: show what is in it, nothing else."""


def document(name: str, title: str, kind: str, sections: Iterable[str], footer: str) -> str:
    """Return a page without scripts or links to anything outside; ``sections`` are HTML already."""
    when = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f'<meta name="viewport" content="width=device-width"><title>{text(title)}</title>'
        f"<style>{stylesheet()}</style></head>\n<body><main>\n"
        f"<header><h1>{text(name)}</h1><p>{text(kind)}, {text(when)}</p></header>\n"
        + "\n".join(sections)
        + f"\n<footer>lfcal {text(__version__)}; {text(footer)}.</footer>"
        "</main></body></html>\n"
    )


def text(value: object) -> str:
    """Return a value as text of HTML."""
    return html.escape(str(value))


def section(title: str, body: str) -> str:
    """Return a section with its heading; nothing where it has no body."""
    return f"<section><h2>{text(title)}</h2>\n{body}</section>" if body else ""


def table(headers: Sequence[str], rows: Iterable[Iterable[str]], numeric: Iterable[int] = ()) -> str:
    """Return a table of cells that are HTML already; columns ``numeric`` stand to the right."""
    right = set(numeric)

    def line(tag: str, cells: Iterable[str]) -> str:
        marks = (' class="n"' if k in right else "" for k in range(100))
        return "<tr>" + "".join(f"<{tag}{m}>{c}</{tag}>" for m, c in zip(marks, cells, strict=False)) + "</tr>"

    body = "\n".join(line("td", row) for row in rows)
    head = f"<thead>{line('th', map(text, headers))}</thead>" if any(headers) else ""
    return f"<table>{head}<tbody>\n{body}</tbody></table>\n"


def figures(pictures: Sequence[ReportPicture], section: str) -> str:
    """Return the pictures of a section."""
    parts = []
    for p in pictures:
        if p.section == section:
            data = base64.b64encode(p.png).decode("ascii")
            caption = text(p.caption)
            parts.append(
                f'<figure><img alt="{caption}" src="data:image/png;base64,{data}">'
                f"<figcaption>{caption}</figcaption></figure>\n"
            )
    return "".join(parts)
