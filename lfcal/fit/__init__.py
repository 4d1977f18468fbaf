"""The optics retrieved from measured patterns: a camera, its effects, and a model of H without noise.

- ``setup``: camera, effects, depths and stage as they are supposed to be
- ``parameters``: unknowns, their groups by registry, the vector of all of them; ``groups``: one concept a module
- ``measured``: the patterns, their noise, which of them are held out; ``spread``: positions spread evenly
- ``model``: what a setup predicts, and the planes of H that it makes; ``_weighing``: residuals in units of their noise
- ``normal``: normal equations; ``problem``: predictions and derivatives at a vector; ``solver``: Levenberg-Marquardt
- ``select``: groups of unknowns that lower the error; ``nuisance``: stage, lamp and pixel response of single patterns
- ``questions``: order of lens types, mirrored axes, sign of depth, another camera
- ``fit``: all of it in order, with a record of each round and the outliers
- ``model_error``: chi² and the model's error; ``_summary``: numbers, and degeneracies; ``result``: the fit
- ``field``: one camera from several regions of the field, its wavefront over it; ``field_files``, ``field_report``:
  its files, and its page
- ``design``: which positions to record next; ``information``: what patterns add; ``earlier``: a fit as a start
- ``files``: camera, effects, numbers and H as files, and all of them in a folder; ``stored``: a fit read back, to fill
  positions that were never recorded
- ``drawing``, ``report``: a fit in pictures and as a page
- ``_residual_field``: what patterns show beyond the model, smooth over neighbours; ``hybrid``: model H with it, and the
  uncertainty of every entry
- ``validate``: points that no fit saw, predicted
- ``locate``, ``_frame_noise``, ``compared``: the source of a new frame, its noise, and its difference from a pattern
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.fit._face import *  # noqa: F403
    from lfcal.fit._shared import *  # noqa: F403

lazy_face(__name__)
