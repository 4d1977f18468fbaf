"""Whether data are good: findings, the verdict, the report, trends, and comparisons of two H.

Everything that says what is wrong gives a `lfcal.base.Finding`, whatever found it; findings have a subject, and
`lfcal.base.verdict_of` writes the verdict.

- ``quality``: metrics that need no camera, found by name
- ``inspection``: these together with the comparison with a camera
- ``evidence``: patterns compared with their camera, each with its light, source and depth
- ``fault``: what a fault is; ``faults``: one family a module, found by name; ``search``: one fault after the other
- ``_cost``: what each adds to the error of a reconstruction, on a patch of H
- ``explained``: how the stated camera disagrees with H
- ``report``: all of it as a page, on paper, and for programs
- ``comparison``, ``pairing``, ``region_loss``: two H, and the regions of one
- ``checking``, ``expected``, ``new_frames``: whether an old H still holds, from new frames
- ``known_object``: how well H of a fit predicts the frame of a known object
- ``trend``, ``dated``: fits and inspections over months
- ``results``: recordings, H, fits, reports, exports and volumes in a folder
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.judge._face import *  # noqa: F403
    from lfcal.judge._shared import *  # noqa: F403

lazy_face(__name__)
