"""The quality report: one HTML page with its pictures, and lists that programs read.

- ``write``: all of it into a folder
- ``page``: the page as text; ``_pictures``: every picture on it; ``_pdf``: the same on paper
- ``two``: two H compared
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.judge.report._face import *  # noqa: F403
    from lfcal.judge.report._shared import *  # noqa: F403

lazy_face(__name__)
