"""Pieces of a fit's pages for people: text, tables, pictures, and the page about them."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable
from pathlib import Path

from lfcal import __version__
from lfcal.base import replace_whole
from lfcal.psf.report import stylesheet

__all__ = ["PAGE", "add_section", "page_of", "paragraphs", "picture_of", "section_of", "table_of", "text_of"]

PAGE = "index.html"
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def text_of(value: object) -> str:
    """Return a value as text of a page."""
    return html.escape(str(value))


def paragraphs(lines: Iterable[str]) -> str:
    """Return lines, each as a paragraph that begins with a capital."""
    return "".join(f"<p>{text_of(one[0].upper() + one[1:])}</p>" for one in lines)


def section_of(title: str, body: str) -> str:
    """Return a section with a title."""
    return f"<section><h2>{text_of(title)}</h2>\n{body}</section>"


def picture_of(content: bytes, caption: str) -> str:
    """Return a picture (PNG), which the page holds, with its caption."""
    data = base64.b64encode(content).decode("ascii")
    words = text_of(caption)
    return f'<figure><img alt="{words}" src="data:image/png;base64,{data}"><figcaption>{words}</figcaption></figure>\n'


def table_of(headers: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table."""
    head = "".join(f"<th>{text_of(one)}</th>" for one in headers)
    body = "\n".join("<tr>" + "".join(f"<td>{text_of(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table>\n"


def page_of(title: str, camera: str, body: Iterable[str]) -> str:
    """Return the page of all sections."""
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f'<meta name="viewport" content="width=device-width"><title>{text_of(title)}</title>'
        f"<style>{stylesheet()}</style></head>\n<body><main>\n<header><h1>{text_of(title)}</h1>"
        f"<p>{text_of(camera)}</p></header>\n"
        + "\n".join(body)
        + f"\n<footer>lfcal {text_of(__version__)}</footer></main></body></html>\n"
    )


def add_section(folder: Path, section: str) -> None:
    """Add a section to the end of the page in ``folder``."""
    page = folder / PAGE
    body, footer, rest = page.read_text(encoding="utf-8").rpartition("\n<footer>")
    with replace_whole(page) as part:
        part.write_text(f"{body}\n{section}{footer}{rest}", encoding="utf-8")
