"""Targets: many points in one frame instead of one.

Points whose cutouts do not overlap are independent measurements. Each has a phase: its position in the period of the
lenslet array. The steps of using a target, and their modules:

1. Describe it: ``target`` (holes, marks; as written on the command line), ``pose`` (its pose, and the uncertainty of
   the pose).
2. Compute where its holes are imaged: ``images`` (chief rays, each hole at its depth), ``phases`` (counted in
lenslets, so that an array may be rotated, distorted, or of fractional period).
3. Plan: ``planning`` (which pitch, how close holes may be, and from there to the plan), ``offsets`` (which offsets
   show all phases), ``expected`` (what noise leaves), ``plan`` (`TargetPlan`, a separate file that holds the scan),
   ``facts`` (what its frames show and cost).
4. Simulate its frames: ``camera`` (`TargetCamera`).
   A target whose points are switched: ``display`` (planned on its pixels), ``subsets`` (which frames may be shown
   together), ``coded`` (the image of each alone, from frames that show several).
5. Find its holes in a frame: ``_spots`` (points of light), ``finding`` (places of one lattice, and which hole each is),
   ``_pose_fit`` (pose, pitch, distortion), ``_mistakes`` (what is not as described).

A scan plan keeps its meaning: a `TargetPlan` holds one, whose positions it shows by other means. See docs/targets.md.
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.targets._face import *  # noqa: F403
    from lfcal.targets._shared import *  # noqa: F403

lazy_face(__name__)
