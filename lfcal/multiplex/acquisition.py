"""Record one light field with several modulators, with the same exposure and the same camera (figure 7)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, InputError, Work, check_number, drained
from lfcal.multiplex.demultiplexing import demultiplex, multiplex
from lfcal.multiplex.modulator import Modulator

__all__ = ["Acquisition", "acquire_light_field", "iter_acquire_light_field"]


@dataclass(frozen=True, eq=False)
class Acquisition:
    """Simulated recording of a scene with one modulator, and its reconstruction.

    Attributes
    ----------
    modulator
        Modulator used for the recording.
    frame
        Recorded frame ``(rows, columns)`` with noise; 1 is unmodulated light at full scale.
    views
        Plenoptic samples ``(N, rows, columns)`` reconstructed from the noisy frame, on the output grid of
        `demultiplex`.
    clean
        Samples of the same shape reconstructed from the frame without noise.
    truth
        Samples of the scene at the positions of ``views``, ``(N, rows, columns)``.
    noise
        Rms of ``views - clean``, the error due to noise.
    error
        Rms of ``views - truth``, the error due to noise and lost resolution.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import Acquisition, acquire_light_field, mask
    >>> light = np.full((9, 60, 60), 1 / 9)
    >>> rng = np.random.default_rng(0)
    >>> one: Acquisition = acquire_light_field(light, [mask("lenslet", 3)], chi2=np.inf, rng=rng)[0]
    >>> print(one.frame.shape, one.views.shape, f"{one.snr_db:.0f} dB")  # 1000 electrons a pixel: sqrt(1000)
    (60, 60) (9, 20, 20) 15 dB
    """

    modulator: Modulator
    frame: NDArray[np.float64] = field(repr=False)
    views: NDArray[Any] = field(repr=False)
    clean: NDArray[Any] = field(repr=False)
    truth: NDArray[np.float64] = field(repr=False)
    noise: float
    error: float

    @property
    def snr_db(self) -> float:
        """Signal-to-noise ratio (dB), 10 log10(mean(`truth`) / `noise`); inf without noise (Ihrke et al., eq. 13)."""
        return 10 * math.log10(float(self.truth.mean()) / self.noise) if self.noise > 0 else math.inf


def iter_acquire_light_field(
    light: ArrayLike,
    modulators: Sequence[Modulator],
    *,
    chi2: float,
    signal_e: float = 1000.0,
    rng: np.random.Generator,
    route: str = "spatial",
    filter: str = "cubic",
) -> Work[list[Acquisition]]:
    """Simulate recordings of a scene with several modulators, with the same camera and exposure; return them in order.

    Parameters
    ----------
    light
        Plenoptic samples at every pixel, ``(N, rows, columns)``. Their sum over N is the unmodulated light, with 1 at
        full scale.
    modulators
        Modulators with N samples each.
    chi2
        Ratio chi^2 of photon to additive noise variance at full scale; inf without read noise.
    signal_e
        Electrons that a pixel collects from unmodulated light with the value 1.
    rng
        Random number generator for shot noise and read noise.
    route, filter
        Route and filter of the reconstruction, as in `demultiplex`.

    Yields
    ------
    Progress
        One step for each modulator.

    Raises
    ------
    InputError
        If ``chi2`` or ``signal_e`` is not above 0, or a modulator does not have as many samples as the scene.
    """
    scene = np.asarray(light, float)
    check_number("electrons of unmodulated light", signal_e, above=0)
    if not chi2 > 0:
        raise InputError.expected("chi^2", "a number above 0, or inf", chi2, "correct this value")
    clock = Clock("acquire", len(modulators))
    results = []
    for k, modulator in enumerate(modulators):
        yield clock.at(k, modulator.name)
        pure = multiplex(scene, modulator)
        # variance s_c^2 + i s_p^2 with s_p^2 = 1/signal: equation 12 per pixel
        read = 0.0 if math.isinf(chi2) else math.sqrt(1 / (signal_e * chi2))
        frame = rng.poisson(np.maximum(pure, 0) * signal_e) / signal_e + read * rng.standard_normal(pure.shape)
        views, clean = (demultiplex(f, modulator, route=route, filter=filter) for f in (frame, pure))
        results.append(_compared(modulator, frame, views, clean, _sampled(scene, modulator, views.shape[1:])))
    yield clock.at(len(modulators))
    return results


acquire_light_field = drained(
    iter_acquire_light_field,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import acquire_light_field, mask
    >>> light = np.full((25, 100, 100), 1 / 25)
    >>> rng = np.random.default_rng(0)
    >>> kinds = [mask("pinhole", 5), mask("lenslet", 5)]
    >>> hole, lens = acquire_light_field(light, kinds, chi2=np.inf, rng=rng, filter="nearest")
    >>> print(f"lenslets gain {lens.snr_db - hole.snr_db:.0f} dB")  # 25 times the photons
    lenslets gain 7 dB
    """,
)


def _sampled(scene: NDArray[np.float64], modulator: Modulator, shape: tuple[int, ...]) -> NDArray[np.float64]:
    (py, px), (my, mx) = modulator.side, modulator.natural_samples
    y, x = (np.arange(n) * p // m + (p // m - 1) // 2 for n, p, m in zip(shape, (py, px), (my, mx), strict=True))
    return scene[:, np.minimum(y, scene.shape[1] - 1)][:, :, np.minimum(x, scene.shape[2] - 1)]


def _compared(
    modulator: Modulator,
    frame: NDArray[np.float64],
    views: NDArray[Any],
    clean: NDArray[Any],
    truth: NDArray[np.float64],
) -> Acquisition:
    noise = float(np.sqrt(np.mean((views - clean) ** 2)))
    error = float(np.sqrt(np.mean((views - truth) ** 2)))
    return Acquisition(modulator, frame, views, clean, truth, noise, error)
