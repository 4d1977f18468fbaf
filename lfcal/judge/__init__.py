"""Judge the quality of data: findings, the verdict, the report, trends, and comparisons of two H.

Every check reports problems as `lfcal.base.Finding`. Each finding has a subject, and `lfcal.base.Judgement` writes the
verdict from all of them.

- ``quality``: metrics that need no camera
- ``inspection``: these metrics together with the comparison with a camera
- ``evidence``: patterns compared with their camera, each with its light, source and depth
- ``fault``: definition of a fault; ``faults``: one family per module; ``search``: detection of faults, one after the
  other
- ``_cost``: effect of each fault on the error of a reconstruction, measured on a patch of H
- ``explained``: disagreement between the stated camera and H
- ``report``: the report as a page, for printing, and for programs
- ``comparison``, ``pairing``, ``region_loss``: comparison of two H, and of the regions of one
- ``checking``, ``expected``, ``new_frames``: check of an old H with new frames
- ``known_object``: prediction of the frame of a known object
- ``trend``, ``dated``: fits and inspections over months
- ``results``: list of recordings, H, fits, reports, exports and volumes in a folder
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.judge._face import *  # noqa: F403
    from lfcal.judge._shared import *  # noqa: F403

lazy_face(__name__)
