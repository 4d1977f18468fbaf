"""Targets with many points per frame instead of one.

Points whose cutouts do not overlap are independent measurements. Each has a phase: its position in the period of the
lenslet array. The steps of using a target, and their modules:

1. Describe it: ``target`` (holes, marks, and the notation of the command line), ``pose`` (its pose, and the
   uncertainty of the pose).
2. Compute where its holes are imaged: ``images`` (chief rays, each hole at its depth), ``phases`` (counted in
   lenslets, so that an array may be rotated, distorted, or of fractional period).
3. Plan: ``planning`` (pitch, smallest spacing of holes, and the plan itself), ``offsets`` (offsets that show all
   phases), ``expected`` (error due to noise), ``plan`` (`TargetPlan`, a separate file that contains the scan),
   ``facts`` (contents and cost of its frames).
4. Simulate its frames: ``camera`` (`TargetCamera`).
5. Switch its points, if it is a display: ``display`` (plans for its pixels), ``subsets`` (frames that may be shown
   together), ``coded`` (single offsets, decoded from frames that show several).
6. Find its holes in a frame: ``_spots`` (points of light), ``finding`` (positions on a lattice, and the label of each
   hole), ``_pose_fit`` (pose, pitch, distortion), ``_mistakes`` (deviations from the description).

A `TargetPlan` contains a scan plan, and shows its positions with a target. See docs/targets.md.
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.targets._face import *  # noqa: F403
    from lfcal.targets._shared import *  # noqa: F403

lazy_face(__name__)
