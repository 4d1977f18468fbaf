"""Check of all links and anchors of the built site; addresses of other sites are not checked."""

from __future__ import annotations

from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

__all__ = ["broken_links"]


@dataclass
class _Page(HTMLParser):
    """Links of a page, and the anchors in it."""

    links: set[str] = field(default_factory=set)
    places: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        for name in ("id", "name"):
            if (value := named.get(name)) is not None:
                self.places.add(value)
        for name in ("href", "src"):
            if (value := named.get(name)) is not None:
                self.links.add(value)


def broken_links(site: Path) -> list[str]:
    """Return ``page: link`` for every broken relative link of the HTML files in ``site``."""
    pages = {path.resolve(): _parsed(path) for path in sorted(site.rglob("*.html"))}
    return [
        f"{path.relative_to(site.resolve())}: {link}"
        for path, page in pages.items()
        # the links of this page begin at the root, because it is shown for missing addresses at any depth
        if path.name != "404.html"
        for link in sorted(page.links)
        if not _leads(link, path, pages)
    ]


def _parsed(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def _leads(link: str, path: Path, pages: dict[Path, _Page]) -> bool:
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return True
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target.is_dir():
        target = target / "index.html"
    if not target.is_file():
        return False
    page = pages.get(target)
    return not parts.fragment or page is None or unquote(parts.fragment) in page.places
