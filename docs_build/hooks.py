"""Functions that mkdocs calls while it builds the site."""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from docs_build.links import broken_links  # noqa: E402
from docs_build.reference import packages, page_of  # noqa: E402
from docs_build.running import TutorialError, run_page, runs  # noqa: E402
from docs_build.screens import take_screens  # noqa: E402
from docs_build.search import repair_search  # noqa: E402
from docs_build.tables import TABLES  # noqa: E402

BESIDE = {
    "CHANGELOG.md": "changelog.md",
    "LICENSE": "licence.md",
    "sample_data/README.md": "sample_data.md",
    "tests/hard_cases/TABLE.md": "tests.md#hard-cases",
    "tests/mutants/TABLE.md": "tests.md#mutants",
    "lfcal/psf/schema/lfcal-psf-2.schema.json": "lfcal-psf-2.schema.json",
    "lfcal/psf/schema/lfcal-psf-4.schema.json": "lfcal-psf-4.schema.json",
}
"""Files of the repository that pages link to, and their pages in the site; an anchor denotes a section of a page."""

SHIM = "assets/iframe-worker.js"
"""File that the search needs if the site is opened from a folder."""

TABLE = re.compile(r"<!-- table: (\w+) -->\n\*The site shows a table here[^\n]*")
"""Place of a table in a page, with the text that readers of the source of the page see."""

TESTS = """# Hard cases and mutants

Two tables show how well the tests detect mistakes: cases in which simple numerical code fails, and mistakes that were
made on purpose.

"""
"""Start of the page with the tables of the tests."""

ABOUT = """Every public name, by package. Names that you import from a package (`from lfcal.psf import ...`) have an
example. The tests run each example in a folder with three entries: the sample session
(`session`), a session that lfcal recorded (`recorded`; both are in `sample_data`), and the H of `lfcal demo`
(`H.h5`)."""

LATE = ("reference/", "changelog.md", "tests.md")
"""Pages that the search lists after the guides."""

_RAN: dict[str, str] = {}
"""Pages after they were run, by their path."""


def on_config(config: Any) -> Any:
    """Append the generated pages to the navigation."""
    listed = [{one.name: one.page} for one in packages(ROOT)]
    config.nav = [*config.nav, {"Python": [{"All packages": "reference/index.md"}, *listed]}]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Run the tutorials, and add the generated pages and pictures to the site."""
    for place, content in {**_beside(), **_reference()}.items():
        files.append(File.generated(config, place, content=content))
    files.append(File.generated(config, SHIM, content=Path(__file__).with_name(Path(SHIM).name).read_text()))
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(1) as pool:
        # another process takes the pictures while the tutorials run
        screens = pool.submit(take_screens, Path(scratch))
        for file in [file for file in files.documentation_pages() if file.generated_by is None]:
            _run(file, files, config)
        for key, picture in screens.result().items():
            files.append(File.generated(config, f"images/workstation/{key}.png", content=picture))
    return files


def _beside() -> dict[str, str]:
    pages = {"licence.md": "# Licence\n\n", "tests.md": TESTS}
    for name, place in BESIDE.items():
        page, _, section = place.partition("#")
        text = (ROOT / name).read_text(encoding="utf-8")
        if section:
            text = re.sub(r"^#", "##", text, flags=re.MULTILINE) + "\n"
        pages[page] = pages.get(page, "") + text
    return pages


def _reference() -> dict[str, str]:
    found = packages(ROOT)
    rows = "\n".join(f"| [`{one.name}`]({one.name}.md) | {one.summary} |" for one in found)
    index = f"# Python packages\n\n{ABOUT}\n\n| package | content |\n| --- | --- |\n{rows}\n"
    return {"reference/index.md": index} | {one.page: page_of(one) for one in found}


def _run(file: File, files: Files, config: Any) -> None:
    markdown = file.content_string
    if not runs(markdown):
        return
    beside = Path(file.src_uri).parent
    there = {str(one.src_uri) for one in files}
    with tempfile.TemporaryDirectory(prefix="lfcal-tutorial-") as scratch:
        shutil.copytree(ROOT / "sample_data" / "session", Path(scratch, "session"))
        try:
            ran = run_page(markdown, Path(scratch), lambda name: (beside / name).as_posix() in there)
        except TutorialError as error:
            raise PluginError(f"{file.src_uri}: {error}") from error
    _RAN[file.src_uri] = ran.markdown
    for name, picture in ran.pictures.items():
        files.append(File.generated(config, (beside / name).as_posix(), content=picture))


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return the page after it was run, with links to files of the repository replaced by links into the site."""
    if page.file.src_uri.startswith(LATE):
        page.meta["search"] = {"boost": 0.003}
    text = _RAN.get(page.file.src_uri, markdown)
    up = "../" * page.file.src_uri.count("/")
    for name, place in BESIDE.items():
        text = re.sub(
            rf"\]\((?:\.\./)*{re.escape(name)}(#[^)]*)?\)",
            lambda m, p=place: f"]({up}{p.partition('#')[0]}{m[1]})" if m[1] else f"]({up}{p})",
            text,
        )
    text = re.sub(r"<!-- keys: (\w+) -->", lambda m: _keys(m[1]), text)
    text = TABLE.sub(lambda m: TABLES[m[1]](), text)
    return re.sub(r"\]\(docs/", f"]({up}", text)


def _keys(key: str) -> str:
    """Return the table of the keys of a page of the window."""
    from lfcal_gui.models.page import PAGES

    pairs = PAGES.get(key).keys
    rows = "\n".join(f"| {keys} | {what} |" for keys, what in pairs)
    return f"| keys | on this page |\n| --- | --- |\n{rows}" if pairs else ""


@event_priority(-200)
def on_post_build(config: Any) -> None:
    """Check all links, and the files that the search needs in a folder, after all plug-ins are done."""
    site = Path(config.site_dir)
    if missing := [name for name in (SHIM, "search/search_index.js") if not (site / name).is_file()]:
        raise PluginError(f"the search does not work from a folder without {', '.join(missing)}")
    if not repair_search(site):
        raise PluginError("the theme's search has changed; adapt or remove docs_build/search.py")
    if broken := broken_links(site):
        raise PluginError("broken links:\n" + "\n".join(broken))
