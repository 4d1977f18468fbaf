"""Every page of documentation is in the list of the site, and every page of the window in its manual."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

import lfcal
from docs_build.screens import PICTURES
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
        # a name that a scene makes of others can be any
        taken = [re.sub(r"\\{\w+\\}", r"\\w+", re.escape(name)) for name in re.findall(r'Capture\(f?"([^"]+)"', text)]
        assert any(re.fullmatch(pattern, state) for pattern in taken), state
    assert PICTURES["accuracy"][1].removeprefix("accuracy_") in PARTS.names()


def test_the_version_is_the_same_everywhere() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["version"]
    changed = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert (
        lfcal.__version__ == cited and changed[0] == "Unreleased" and all(re.match(r"\d+\.\d+", v) for v in changed[1:])
    )
    assert re.fullmatch(r"\d+\.\d+\.\d+", lfcal.__version__)
    assert 'dynamic = ["version"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_the_bibtex_entry_is_that_of_the_citation_file() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    (entry,) = re.findall(r"```bibtex\n@software\{lfcal,\n(.*?)\}\n```", page, re.DOTALL)
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


def test_what_the_commands_of_the_pages_install_is_there() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    names = {"extra": set(project["project"]["optional-dependencies"]), "group": set(project["dependency-groups"])}
    pages = [ROOT / "README.md", ROOT / "mkdocs.yml", *DOCS.rglob("*.md")]
    said = [match for page in pages for match in re.findall(r"--(extra|group) (\w+)", page.read_text(encoding="utf-8"))]
    assert {("extra", "gui"), ("group", "docs")} <= set(said) <= {(k, name) for k in names for name in names[k]}
    # the site is built by its group alone, and its pictures are of the window
    assert "lfcal[gui]" in project["dependency-groups"]["docs"]


def test_the_map_names_every_package() -> None:
    text = (DOCS / "contributing.md").read_text(encoding="utf-8")
    packages = {path.parent.name for path in (ROOT / "lfcal").glob("*/__init__.py")}
    assert not {name for name in packages if f" {name}/" not in text}


def test_the_projection_formula_says_where_voxels_and_pixels_count_from() -> None:
    """On whole sensor frames they count from the anchor: without it every phase is another."""
    without = []
    for path in DOCS.rglob("*.md"):
        for part in re.split(r"\n\s*\n|\n[-*] ", path.read_text(encoding="utf-8")):
            if "f[p] =" in part and "anchor" not in part and "position (0, 0)" not in part:
                without.append(path.name)
    assert not without


def test_modules_of_parts_that_are_shown_have_docstrings() -> None:
    """As the tests of the architecture require of every module of lfcal."""
    for section in ("A frame format", "An effect", "A check of H", "A fault", "A solver", "A page of the window"):
        blocks = code_of("extending.md", section)
        modules = [block for block in blocks if re.search(r"^(def|class) ", block, re.MULTILINE)]
        assert modules and all(block.startswith('"""') for block in modules), section


def anchors_of(page: Path) -> set[str]:
    """Return the places of a page that links name: its headings as the site writes them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    plain = (re.sub(r"[^\w\s-]", "", re.sub(r"`|\[([^\]]*)\]\([^)]*\)", r"\1", title)) for title in titles)
    return {re.sub(r"[-\s]+", "-", title.strip().lower()) for title in plain}


def test_links_between_pages_lead_somewhere() -> None:
    """As they are in the repository and in the window; the site checks its own."""
    made = {DOCS / name for name in ("changelog.md", "licence.md", "reference/index.md")}
    broken = []
    for page in [ROOT / "README.md", *DOCS.rglob("*.md")]:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for link in re.findall(r"\]\(((?!https?:|#)[^)\s]+)\)", text):
            name, _, anchor = link.partition("#")
            target = (page.parent / name).resolve()
            if target in made or (DOCS / "reference") in target.parents or name.endswith(".png"):
                continue
            if not target.is_file() or (anchor and anchor not in anchors_of(target)):
                broken.append(f"{page.name}: {link}")
    assert not broken


def test_helps_of_fields_are_literal() -> None:
    """The reference takes them from the source, which it does not run."""
    composed = []
    for path in sorted((ROOT / "lfcal").rglob("*.py")):
        records = (node for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, ast.ClassDef))
        for field in (one for record in records for one in record.body if isinstance(one, ast.AnnAssign)):
            call = field.value
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in ("opt", "required"):
                if not isinstance(call.args[call.func.id == "opt"], ast.Constant):
                    composed.append(f"{path.name}: {ast.unparse(field.target)}")
    assert not composed


def test_tables_of_the_tests_are_sections_of_one_page() -> None:
    pytest.importorskip("mkdocs", reason="the group of packages that build the documentation is not installed")
    from docs_build.hooks import _beside, on_page_markdown

    made = _beside()
    assert {"tests.md", "licence.md", "lfcal-psf-4.schema.json"} <= set(made)
    headings = re.findall(r"^#{1,2} .*$", made["tests.md"], re.MULTILINE)
    assert headings == ["# Hard cases and mutants", "## Hard cases", "## Mutants"]
    page = SimpleNamespace(file=SimpleNamespace(src_uri="tutorials/a.md"))
    shown = on_page_markdown("[a](../../tests/mutants/TABLE.md) [b](../../CHANGELOG.md#new)", page)
    assert shown == "[a](../tests.md#mutants) [b](../changelog.md#new)"
