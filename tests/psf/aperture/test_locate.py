import numpy as np

from lfcal.psf.aperture._locate import despike


def test_spikes_go_and_corners_stay():
    """A clean corner lies far off the median of its neighbours, as a hot pixel does, but within their range."""
    image = np.zeros((41, 41))
    image[10:31, 10:31] = 1.0
    image += np.random.default_rng(0).normal(0, 1e-3, image.shape)
    hot = image.copy()
    hot[20, 20] += 1.0
    hot[5, 5] += 0.5
    clean = despike(hot)
    assert abs(clean[20, 20] - 1) < 0.01 and abs(clean[5, 5]) < 0.01
    untouched = np.ones(image.shape, bool)
    untouched[20, 20] = untouched[5, 5] = False
    assert np.array_equal(clean[untouched], hot[untouched])


def test_an_image_without_noise_is_left_alone():
    image = np.zeros((21, 21))
    assert despike(image) is image
