"""Description of a page before it is opened (name, icon, state), and the registry of all pages. No Qt."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from lfcal.base import Registry
from lfcal_gui.models.project import ProjectState

ZARR = ".zarr"
"""Suffix of a folder in the format OME-Zarr."""


class PageState(Enum):
    """State of a page; the value is the displayed text."""

    NOTHING = "nothing yet"
    READY = "ready"
    RUNNING = "running"
    DONE = "done"
    ATTENTION = "needs attention"


@dataclass(frozen=True)
class WindowPlace:
    """One of the four places in the rail of the main window; each of its pages is displayed as a view of the place.

    Attributes
    ----------
    key, title
        Key for programs, and displayed title.
    question
        Question that the place answers.
    """

    key: str
    title: str
    question: str


PLACES = (
    WindowPlace("setup", "Set up", "Will this scan work, and what does it cost?"),
    WindowPlace("record", "Record", "Are the frames right, are they safe, and how long does it take?"),
    WindowPlace("h", "H", "Is H good, and if not, what helps?"),
    WindowPlace("use", "Use", "How do I export H, and what does it reconstruct?"),
)


@dataclass(frozen=True)
class PageSpec:
    """Description of one page of the window, which its folder defines as ``PAGE``.

    Attributes
    ----------
    key, title
        Key for programs (project files, jobs, ``Context.go``), and displayed title.
    hint
        One sentence on the purpose of the page.
    order
        Sort key among the views of its place or in the menu *More*, ascending; pages of lfcal have 10, 20, … 90.
    package
        The page's folder as a package; ``package.page`` has the class ``Page`` and is imported when the page is opened.
    state
        Returns the state of the page for a project; called after every change, so it must be fast.
    needs
        Package that the page requires; empty if none.
    place
        Key of the `WindowPlace` that the page is a view of; empty: it has its own window, in the menu *More*.
    keys
        Pairs of key and meaning, for the list of keyboard shortcuts.
    takes
        Returns whether the page may accept a file or folder dropped elsewhere. Only then is the page created and
        asked. None: it is always asked.
    """

    key: str
    title: str
    hint: str
    order: float
    package: str
    state: Callable[[ProjectState], PageState]
    needs: str = ""
    place: str = ""
    keys: tuple[tuple[str, str], ...] = ()
    takes: Callable[[str], bool] | None = None

    @property
    def name(self) -> str:
        """The key, by which the registry finds the page."""
        return self.key


def page_registry() -> Registry[PageSpec]:
    """Return a registry that searches ``lfcal_gui.pages`` and the entry points ``lfcal.pages``."""
    return Registry("page", "lfcal_gui.pages", "PAGE", "lfcal.pages", order=_order, check=_check)


def _order(spec: PageSpec) -> tuple[float, str]:
    return spec.order, spec.key


def _check(spec: PageSpec) -> None:
    if not isinstance(spec, PageSpec):
        raise TypeError(f"expected a PageSpec, got {type(spec).__name__}")


PAGES = page_registry()
"""All pages; the window omits those whose part of the library is not installed."""


def available_pages(pages: Iterable[PageSpec] = PAGES) -> tuple[PageSpec, ...]:
    """Return the pages whose part of the library is installed, in order."""
    return tuple(spec for spec in pages if not spec.needs or _exists(spec.needs))


def _exists(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def is_image(path: str) -> bool:
    """Return whether a path may be one image: a file, or a folder in the format OME-Zarr."""
    from lfcal.frames.formats import image_suffixes

    suffix, place = Path(path).suffix.lower(), Path(path)
    return place.is_dir() if suffix == ZARR else suffix in image_suffixes() and place.is_file()


def nothing(path: str) -> bool:
    """Return False: the page accepts no file dropped elsewhere."""
    return False


def page_states(
    project: ProjectState,
    pages: Iterable[PageSpec] = PAGES,
    running: Collection[str] = (),
    attention: Collection[str] = (),
) -> dict[str, PageState]:
    """Return the state of every page by key; checks whether the project's files exist, without reading them.

    Parameters
    ----------
    project
        The project.
    pages
        The pages to include.
    running, attention
        Keys of pages with a running job, and of pages that need attention.
    """
    found = {spec.key: spec.state(project) for spec in pages}
    found |= dict.fromkeys(found.keys() & set(attention), PageState.ATTENTION)
    return found | dict.fromkeys(found.keys() & set(running), PageState.RUNNING)


def file_state(path: str, *, ready: bool) -> PageState:
    """Return the state of a page that makes the file ``path``; ``ready``: whether it can be made now."""
    if path:
        # the file of the project is gone
        return PageState.DONE if Path(path).exists() else PageState.ATTENTION
    return PageState.READY if ready else PageState.NOTHING
