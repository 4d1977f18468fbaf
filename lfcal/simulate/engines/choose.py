"""Choose the engine for a scene and a level of accuracy."""

from __future__ import annotations

from functools import partial

from lfcal.base import InputError, check_choice
from lfcal.simulate._pupil_scene import AnyScene, PupilScene
from lfcal.simulate.engines.base import LEVELS, PlaneEngine, Sampling

__all__ = ["engine_for"]


def engine_for(scene: AnyScene, level: str = "wave", sampling: Sampling | None = None) -> PlaneEngine:
    """Return the engine of ``level``, one of `LEVELS`, for ``scene``, including its tables.

    ``sampling`` sets the samples and windows of the engine. None: the default values of `Sampling`.

    Raises
    ------
    InputError
        If the level is unknown or not possible for the scene, or the sampling requires too large a table.
    """
    check_choice("level", level, LEVELS)
    chosen = sampling or Sampling()
    if isinstance(scene, PupilScene):
        from lfcal.simulate.engines.pupil import PUPIL_LEVELS, PupilPlane

        if level not in PUPIL_LEVELS:
            wanted = f"auto, {' or '.join(PUPIL_LEVELS)} for a Fourier light-field microscope"
            raise InputError.expected("level", wanted, repr(level), "choose auto")
        return PupilPlane(scene, level, chosen)
    if scene.pixel_aspect != 1:
        from lfcal.simulate.engines._oblong import OblongPlane

        return OblongPlane(scene, chosen, partial(engine_for, level=level))
    if level == "debye":
        if scene.objective is None:
            raise InputError.expected("Debye path", "a microscope", "a main lens", "use the level wave")
        from lfcal.simulate.engines.microscope import debye_plane

        return debye_plane(scene, chosen)
    if level == "geometric":
        from lfcal.simulate.engines._geometric import GeometricPlane

        return GeometricPlane(scene)
    if not scene.lenslet_diffraction:
        raise InputError.expected(
            "lenslet diffraction (lenslet_diffraction)",
            f"on, because the level is {level}",
            "off",
            "switch it on, or use the level geometric",
        )
    if level == "reference":
        from lfcal.simulate.engines._fields_sum import reference_plane

        return reference_plane(scene, chosen)
    if level == "grid":
        from lfcal.simulate.engines._fields_sum import grid_plane

        return grid_plane(scene, chosen)
    from lfcal.simulate.engines._fields_sum import wave_plane

    return wave_plane(scene, chosen)
