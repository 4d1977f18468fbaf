"""The optics retrieved from measured patterns: a camera, its effects, and a model of H without noise.

- ``setup``: camera, effects, depths and stage as they are supposed to be
- ``parameters``: unknowns, their groups by registry, the vector of all of them; ``groups``: one concept a module
- ``measured``: the patterns, their noise, which of them are kept aside; ``spread``: positions spread evenly
- ``model``: what a setup predicts; ``weighing``: residuals in units of their noise
- ``normal``: normal equations; ``problem``: predictions and derivatives at a vector; ``solver``: Levenberg-Marquardt
- ``select``: which groups a scan calls for; ``nuisance``: stage and lamp of single patterns; ``outliers``
- ``questions``: order of lens types, mirrored axes, sign of depth, another camera
- ``convergence``: what each round of a fit leaves
- ``judge``: chi² and the model's error; ``stand_ins``: what could be otherwise in place of what was found;
  ``summary``, ``result``: what was found and how sure it is
- ``fit``: all of it in order
- ``regional``, ``field``: one camera from several regions of the field, its wavefront over it; ``field_files``,
  ``field_report``: its files, and its page
- ``design``: which positions to record next; ``information``: what patterns tell; ``earlier``: a fit to go on from
- ``files``: camera, effects, numbers and H as files; ``writing``: all of them in a folder
- ``drawing``, ``page``, ``report``: a fit in pictures and as a page; ``design_drawing``: expected errors
- ``locate``, ``frame_noise``, ``expected``, ``compared``, ``suspects``, ``followed``, ``holds``: whether an
  old H still holds, from new frames
- ``dated``, ``trend``: fits of a camera over months
- ``leftover_size``, ``leftover_field``, ``leftover``: what patterns show beyond the model, smooth over neighbours
- ``fitted``, ``hybrid_patterns``, ``hybrid``: model H with it, and the uncertainty of every entry
- ``stored``: a fit read back, to fill what a scan never recorded
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.fit._face import *  # noqa: F403
    from lfcal.fit._shared import *  # noqa: F403

lazy_face(__name__)
