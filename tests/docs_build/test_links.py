"""A link of the site that leads nowhere is named with its page."""

from __future__ import annotations

from pathlib import Path

from docs_build.links import broken_links


def test_links_that_lead_nowhere_are_named(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "a.html").write_text(
        '<h1 id="top">A</h1><a href="sub/b.html#there">b</a> <a href="#top">up</a> <img src="p.png">'
        '<a href="sub/">folder</a><a href="https://example.org/x">elsewhere</a><a href="mailto:a@b.c">mail</a>'
    )
    (tmp_path / "p.png").write_bytes(b"")
    (tmp_path / "sub" / "index.html").write_text('<a href="../a.html">back</a>')
    (tmp_path / "sub" / "b.html").write_text('<a name="there"></a><a href="../a.html#top">a</a>')
    assert broken_links(tmp_path) == []
    (tmp_path / "sub" / "b.html").write_text(
        '<a href="../nosuch.html">x</a><a href="../a.html#gone">y</a><img src="q.png">'
    )
    (tmp_path / "404.html").write_text('<a href="/anything">z</a>')
    assert broken_links(tmp_path) == [
        "a.html: sub/b.html#there",
        "sub/b.html: ../a.html#gone",
        "sub/b.html: ../nosuch.html",
        "sub/b.html: q.png",
    ]
