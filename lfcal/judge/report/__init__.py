"""The quality report: one HTML page with its images, and lists that programs read.

- ``write``: write all files into a folder
- ``page``: the page as text; ``_pictures``: its images; ``_pdf``: the same as PDF
- ``two``: comparison of two H
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.judge.report._face import *  # noqa: F403
    from lfcal.judge.report._shared import *  # noqa: F403

lazy_face(__name__)
