"""The pages of the site: all are listed, their links, pictures and messages exist, and versions agree."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
import yaml

import lfcal
from docs_build.links import broken_links
from docs_build.screens import PICTURES
from docs_build.search import repair_search
from lfcal.accuracy import PARTS
from tests.distribution import code_of

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
MADE = {"changelog.md", "licence.md", "sample_data.md", "tests.md"}
"""Pages that are made of other files while the site is built."""


def listed(nav: list[Any]) -> list[str]:
    found: list[str] = []
    for entry in nav:
        (value,) = entry.values()
        found += [value] if isinstance(value, str) else listed(value)
    return found


def test_every_page_is_listed_once() -> None:
    nav = listed(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])
    there = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    assert sorted(nav) == sorted(there | MADE)


def test_every_page_of_the_window_is_shown_with_its_picture_and_keys() -> None:
    text = (DOCS / "workstation.md").read_text(encoding="utf-8")
    pages = [p.name for p in (ROOT / "gui" / "lfcal_gui" / "pages").iterdir() if (p / "page.py").is_file()]
    assert (
        set(re.findall(r"images/workstation/(\w+)\.png", text)) == set(pages) == set(re.findall(r"keys: (\w+)", text))
    )


def test_every_picture_of_a_page_is_taken_in_a_scene() -> None:
    pages = "".join(path.read_text(encoding="utf-8") for path in DOCS.rglob("*.md"))
    assert set(re.findall(r"images/workstation/(\w+)\.png", pages)) == set(PICTURES)
    for scene, state in PICTURES.values():
        module, _, function = scene.partition(".")
        text = (ROOT / "gui" / "lfcal_gui" / "scenes" / f"{module}.py").read_text(encoding="utf-8")
        assert f"def {function}(stage: Stage)" in text, scene
        # a name that a scene composes can be any
        taken = [re.sub(r"\\{\w+\\}", r"\\w+", re.escape(name)) for name in re.findall(r'Capture\(f?"([^"]+)"', text)]
        assert any(re.fullmatch(pattern, state) for pattern in taken), state
    assert PICTURES["accuracy"][1].removeprefix("accuracy_") in PARTS.names()


def test_version_and_citation_are_the_same_everywhere() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    changed = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert lfcal.__version__ == cited["version"] and re.fullmatch(r"\d+\.\d+\.\d+", lfcal.__version__)
    assert changed[0] == "Unreleased" and all(re.match(r"\d+\.\d+", version) for version in changed[1:])
    assert 'dynamic = ["version"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (entry,) = re.findall(
        r"```bibtex\n@software\{lfcal,\n(.*?)\}\n```", (DOCS / "index.md").read_text("utf-8"), re.DOTALL
    )
    fields = {name: value.strip("{}") for name, value in re.findall(r"(\w+) += (\{.*\})", entry)}
    wanted = {name: cited[name] for name in ("title", "version", "license")}
    assert fields == {"author": cited["authors"][0]["name"], **wanted}


def test_the_readme_of_a_package_index_has_no_relative_link() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    home = project["project"]["urls"]["Homepage"]
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for rule in project["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        assert home in rule["replacement"], "one address"
        text = re.sub(rule["pattern"], rule["replacement"], text)
    links = re.findall(r"(!?)\[[^]]*\]\(([^)]*)\)", text)
    assert len(links) > 10 and all(link.startswith("https://") for _, link in links)
    assert all(link.startswith(f"{home}/raw/") for mark, link in links if mark), "pictures are not pages"
    for name in re.findall(rf"{re.escape(home)}/\w+/main/([^)]+)\)", text):
        assert (ROOT / name).exists(), name


def test_the_map_names_every_package() -> None:
    text = (DOCS / "contributing.md").read_text(encoding="utf-8")
    packages = {path.parent.name for path in (ROOT / "lfcal").glob("*/__init__.py")}
    assert not {name for name in packages if f" {name}/" not in text}


def test_the_projection_formula_says_where_voxels_and_pixels_count_from() -> None:
    """On whole frames they count from the anchor; another origin changes every phase."""
    without = []
    for path in DOCS.rglob("*.md"):
        for part in re.split(r"\n\s*\n|\n[-*] ", path.read_text(encoding="utf-8")):
            if "f[p] =" in part and "anchor" not in part and "position (0, 0)" not in part:
                without.append(path.name)
    assert not without


def test_modules_shown_on_a_page_have_docstrings() -> None:
    for section in ("A frame format", "An effect", "A check of H", "A fault", "A solver", "A page of the window"):
        blocks = code_of("extending.md", section)
        modules = [block for block in blocks if re.search(r"^(def|class) ", block, re.MULTILINE)]
        assert modules and all(block.startswith('"""') for block in modules), section


def test_help_texts_of_fields_are_literal() -> None:
    """The reference takes them from the source, which it does not run."""
    composed = []
    for path in sorted((ROOT / "lfcal").rglob("*.py")):
        source = path.read_bytes()
        if b"opt(" not in source and b"required(" not in source:
            continue
        records = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef))
        for field in (one for record in records for one in record.body if isinstance(one, ast.AnnAssign)):
            call = field.value
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in ("opt", "required"):
                if not isinstance(call.args[call.func.id == "opt"], ast.Constant):
                    composed.append(f"{path.name}: {ast.unparse(field.target)}")
    assert not composed


def test_extras_and_groups_of_the_pages_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    names = {"extra": set(project["project"]["optional-dependencies"]), "group": set(project["dependency-groups"])}
    pages = [ROOT / "README.md", ROOT / "mkdocs.yml", *DOCS.rglob("*.md")]
    said = {match for page in pages for match in re.findall(r"--(extra|group) (\w+)", page.read_text(encoding="utf-8"))}
    assert {("extra", "gui"), ("group", "docs")} <= said <= {(k, name) for k in names for name in names[k]}
    # the site is built by its group alone, and its pictures are of the window
    assert "lfcal[gui]" in project["dependency-groups"]["docs"]


def without_code(page: Path) -> str:
    return re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def anchors_of(page: Path) -> set[str]:
    """Return the anchors of a page: its headings as the site writes them."""
    titles = re.findall(r"^#+ (.+)$", without_code(page), re.MULTILINE)
    plain = (re.sub(r"[^\w\s-]", "", re.sub(r"`|\[([^\]]*)\]\([^)]*\)", r"\1", title)) for title in titles)
    return {re.sub(r"[-\s]+", "-", title.strip().lower()) for title in plain}


def test_links_between_pages_lead_somewhere() -> None:
    """As they are in the repository and in the window; the site checks its own."""
    made = {DOCS / name for name in ("changelog.md", "licence.md", "reference/index.md")}
    broken = []
    for page in [ROOT / "README.md", *DOCS.rglob("*.md")]:
        for link in re.findall(r"\]\(((?!https?:|#)[^)\s]+)\)", without_code(page)):
            name, _, anchor = link.partition("#")
            target = (page.parent / name).resolve()
            if target in made or (DOCS / "reference") in target.parents or name.endswith(".png"):
                continue
            if not target.is_file() or (anchor and anchor not in anchors_of(target)):
                broken.append(f"{page.name}: {link}")
    assert not broken


def test_broken_links_of_the_site_are_found(tmp_path: Path) -> None:
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


def test_the_search_keeps_states_with_digits_apart(tmp_path: Path) -> None:
    worker = tmp_path / "assets" / "javascripts" / "workers" / "search.0a1b.min.js"
    worker.parent.mkdir(parents=True)
    worker.write_text("for(;i<n;i++){var s=r[i],o=this.edges[s];e=e+s+o.id}return e},t.x=1", encoding="utf-8")
    assert repair_search(tmp_path)
    assert 'e=e+s+o.id+","}return e}' in worker.read_text(encoding="utf-8")
    assert not repair_search(tmp_path), "a worker that does not join them is left alone"


def test_the_tables_of_the_tests_are_sections_of_one_page() -> None:
    pytest.importorskip("mkdocs", reason="the group of packages that build the documentation is not installed")
    from docs_build.hooks import _beside, on_page_markdown

    made = _beside()
    assert {"tests.md", "licence.md", "lfcal-psf-4.schema.json"} <= set(made)
    headings = re.findall(r"^#{1,2} .*$", made["tests.md"], re.MULTILINE)
    assert headings == ["# Hard cases and mutants", "## Hard cases", "## Mutants"]
    page = SimpleNamespace(file=SimpleNamespace(src_uri="tutorials/a.md"))
    shown = on_page_markdown("[a](../../tests/mutants/TABLE.md) [b](../../CHANGELOG.md#new)", page)
    assert shown == "[a](../tests.md#mutants) [b](../changelog.md#new)"


# -- troubleshooting ---------------------------------------------------------------------------------------


SEPARATORS = r"…|: expected |, got |; "
"""Between the parts of a message: `InputError.expected` joins them."""


def texts_of(source: str) -> str:
    """Return the texts of a program, a line each."""
    constants = (node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant))
    return "\n".join(value for value in constants if isinstance(value, str))


def test_every_message_of_troubleshooting_exists_in_the_sources() -> None:
    page = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    messages = re.findall(r"^### `(.+)`$", page, re.MULTILINE)
    assert len(messages) == len(set(messages)) >= 25
    parts = (part.strip() for message in messages for part in re.split(SEPARATORS, message))
    missing = {part for part in parts if len(part) > 3}
    folders = (ROOT / "lfcal", ROOT / "gui", Path(typer.__file__).parent)
    sources = [path.read_text(encoding="utf-8") for folder in folders for path in folder.rglob("*.py")]
    # first where a part is in one line: most sources need not be parsed
    for several_lines in (False, True):
        for source in sources:
            if (several_lines and missing) or any(part in source for part in missing):
                texts = texts_of(source)
                missing = {part for part in missing if part not in texts}
    assert not missing
