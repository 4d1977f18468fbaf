"""Retrieve the optics from measured patterns: a camera, its effects, and a model of H without noise.

- ``setup``: the assumed camera, effects, depths and stage
- ``parameters``: unknowns, their groups by registry, and the vector of all unknowns; ``groups``: one group per module
- ``measured``: patterns, their noise, and the patterns that are held out; ``spread``: evenly spread positions
- ``model``: predictions of a setup, and planes of H computed from it; ``_weighing``: residuals in units of their noise
- ``normal``: normal equations; ``problem``: predictions and derivatives at a vector; ``solver``: Levenberg-Marquardt
- ``select``: choice of groups of unknowns that lower the error; ``nuisance``: stage, lamp and pixel response of single
  patterns
- ``questions``: order of lens types, mirrored axes, sign of depth, wrong camera
- ``fit``: the complete fit, with a record of each round and the outliers
- ``model_error``: chi² and the model's error; ``_summary``: numbers, and degeneracies; ``result``: the fit
- ``field``: one camera from several regions of the field, with its wavefront over the field; ``field_files``,
  ``field_report``: its files, and its page
- ``design``: positions to record next; ``information``: information in patterns; ``earlier``: an earlier fit as a
  start
- ``files``: files of camera, effects, numbers and H, and the folder with all of them; ``stored``: a stored fit that
  fills positions that were never recorded
- ``drawing``, ``report``: plots and report page of a fit
- ``_residual_field``: residuals beyond the model that are smooth over neighbours; ``hybrid``: model H plus this field,
  with the uncertainty of every entry
- ``validate``: prediction of points that were not fitted
- ``locate``, ``_frame_noise``, ``compared``: the source of a new frame, its noise, and its difference from a pattern
  of H
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.fit._face import *  # noqa: F403
    from lfcal.fit._shared import *  # noqa: F403

lazy_face(__name__)
