"""The optics retrieved from measured patterns: a camera, its effects, and a model of H without noise.

- ``setup``: camera, effects, depths and stage as they are supposed to be
- ``parameters``: unknowns, their groups by registry, the vector of all of them; ``groups``: one concept a module
- ``measured``: the patterns, their noise, which of them are kept aside; ``spread``: positions spread evenly
- ``model``: what a setup predicts; ``weighing``: residuals in units of their noise
- ``normal``: normal equations; ``problem``: predictions and derivatives at a vector; ``solver``: Levenberg-Marquardt
- ``select``: which groups a scan calls for; ``nuisance``: stage and lamp of single patterns; ``outliers``
- ``questions``: order of lens types, mirrored axes, sign of depth, another camera
- ``judge``: chi² and the model's error; ``summary``, ``result``: what was found and how sure it is
- ``fit``: all of it in order
- ``leftover_size``, ``leftover_field``, ``leftover``: what patterns show beyond the model, smooth over neighbours
- ``fitted``, ``hybrid_patterns``, ``hybrid``: model H with it, and the uncertainty of every entry
- ``stored``: a fit read back, to fill what a scan never recorded
- ``files``: camera, effects, numbers and H as files; ``drawing``, ``report``: a fit in pictures and as a page
"""

from lfcal.fit.fit import fit_camera, iter_fit_camera
from lfcal.fit.measured import Measured, measured_of
from lfcal.fit.parameters import GROUPS, Group, Unknown
from lfcal.fit.result import Fit, Outlier, Parameter
from lfcal.fit.setup import Setup

__all__ = [
    "GROUPS",
    "Fit",
    "Group",
    "Measured",
    "Outlier",
    "Parameter",
    "Setup",
    "Unknown",
    "fit_camera",
    "iter_fit_camera",
    "measured_of",
]
