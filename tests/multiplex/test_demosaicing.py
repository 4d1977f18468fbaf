"""Demosaicing by estimation: best linear weights, blending by direction, photographs, and frames of real cameras."""

from __future__ import annotations

import importlib.util
import itertools
import warnings
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import pytest
import rawpy
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.frames import ArraySource, channel_source, open_frames, open_image, read_image
from lfcal.lattice import extract_views, fit_lattice
from lfcal.multiplex import (
    Modulator,
    SuperPixelLattice,
    cfa,
    demultiplex,
    lattice_channels,
    mask,
    modulator_from_matrix,
    multiplex,
)
from lfcal.multiplex._demosaicing import (
    ALONG_COLUMNS,
    ALONG_ROWS,
    EVEN,
    Prior,
    _continued,
    estimation_weights,
    reach_of,
    thinned,
)
from lfcal.psf import Cutout, assemble
from tests.frames.scenes import shared

RNG = np.random.default_rng
Array = NDArray[Any]

SIX = (
    ("skimage", "data/astronaut.png"),
    ("skimage", "data/chelsea.png"),
    ("skimage", "data/coffee.png"),
    ("skimage", "data/rocket.jpg"),
    ("sklearn", "datasets/images/china.jpg"),
    ("sklearn", "datasets/images/flower.jpg"),
)
"""Public photographs that ship with scikit-image and scikit-learn."""


def by_kriging(m: Modulator, prior: Prior, reach: int, a: int, b: int) -> Array:
    """Return the weights of pixel (a, b) by the textbook system with Lagrange multipliers, entry by entry."""
    around = [(dy, dx) for dy in range(-reach, reach + 1) for dx in range(-reach, reach + 1)]
    seen = [m.matrix[(a + dy) % m.side[0] * m.side[1] + (b + dx) % m.side[1]] for dy, dx in around]

    def covariance(u: Array, v: Array, dy: int, dx: int) -> float:
        far = ((dy * prior.elongation) ** 2 + (dx / prior.elongation) ** 2) ** 0.5
        mean = u.mean() * v.mean() * m.count
        return float(mean + prior.chroma * (u @ v - mean)) * np.exp(-far / prior.length_px)

    k, n = len(around), m.count
    system = np.zeros((k + n, k + n))
    right = np.zeros((k + n, n))
    for i, (dy, dx) in enumerate(around):
        for j, (ey, ex) in enumerate(around):
            system[i, j] = covariance(seen[i], seen[j], dy - ey, dx - ex) + prior.noise * (i == j)
        system[i, k:] = system[k:, i] = seen[i]
        for s in range(n):
            right[i, s] = covariance(seen[i], np.eye(n)[s], dy, dx)
    right[k:] = np.eye(n)
    return np.linalg.solve(system, right)[:k].T.reshape(n, 2 * reach + 1, -1)


@pytest.mark.few(4)
@pytest.mark.parametrize("name", ["Bayer", "CYMG", "RGB/GBR"])
@pytest.mark.parametrize("levels", [(1.0, 1.0, 1.0), (0.5, 1.0, 0.7)])
@pytest.mark.parametrize("prior", [EVEN, ALONG_ROWS, Prior(5.0, 1.3, 0.3, 0.1)])
def test_weights_are_the_best_unbiased_ones(name: str, prior: Prior, levels: tuple[float, ...]) -> None:
    m = cfa(name)
    found = estimation_weights(m, prior, 2, np.array(levels))
    # samples in units of their levels, seen by filters that pass as much more of them
    scaled = modulator_from_matrix(name, m.side, m.matrix * levels, colours=m.colours)
    for k in range(m.pixels):
        wanted = by_kriging(scaled, prior, 2, *divmod(k, m.side[1])) * np.array(levels)[:, None, None]
        np.testing.assert_allclose(found[k], wanted, atol=1e-9)


def test_noise_makes_the_estimate_average() -> None:
    """What a pixel measured is kept where it is sure, and shared with its neighbours where it is not."""
    green = [estimation_weights(cfa("GRBG"), Prior(noise=noise), 3)[0, 1] for noise in (1e-9, 0.3)]
    assert green[0][3, 3] == pytest.approx(1, abs=1e-6)
    assert (green[1] ** 2).sum() < 0.2


def test_small_weights_are_left_out_at_no_cost() -> None:
    y, x = np.indices((7, 7)) - 3
    for m in map(cfa, ("Bayer", "CYMG", "X-Trans")):
        full = estimation_weights(m, EVEN, 3)
        few = thinned(full, m)
        assert np.count_nonzero(few) < 0.85 * full.size and np.abs(few - full).max() < 0.012
        for k in range(m.pixels):
            a, b = divmod(k, m.side[1])
            seen = m.matrix[(a + y) % m.side[0] * m.side[1] + (b + x) % m.side[1]]
            np.testing.assert_allclose(np.einsum("nyx,yxs->ns", few[k], seen), np.eye(3), atol=1e-12)


def plain(frame: Array, m: Modulator, weights: Array) -> Array:
    """Weigh the windows by plain loops over a frame continued by `_continued`."""
    reach = weights.shape[2] // 2
    rows, columns = (_continued(n, reach, s) for n, s in zip(frame.shape, m.side, strict=True))
    wide = frame[np.ix_(rows, columns)]
    out = np.empty((m.count, *frame.shape))
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            window = wide[y : y + 2 * reach + 1, x : x + 2 * reach + 1]
            out[:, y, x] = (weights[y % m.side[0] * m.side[1] + x % m.side[1]] * window).sum((1, 2))
    return out


def by_differences(frame: Array, m: Modulator) -> Array:
    """Return the scale of each sample: least squares on the rms change of every pixel of a super-pixel."""
    rms = []
    for a, b in np.ndindex(m.side):
        channel = frame[a :: m.side[0], b :: m.side[1]]
        steps = [*np.diff(channel, axis=0).ravel(), *np.diff(channel, axis=1).ravel()]
        rms.append(np.sqrt(np.mean(np.square(steps))))
    levels = np.linalg.lstsq(m.matrix, np.array(rms), rcond=None)[0]
    return np.maximum(levels, 0.05 * levels.max()) / np.maximum(levels, 0.05 * levels.max()).mean()


@pytest.mark.parametrize("name", ["GRBG", "RGB/GBR", "RGBW 4x4"])
def test_both_filters_are_those_of_plain_loops(name: str) -> None:
    m = cfa(name)
    frame = RNG(1).random((4 * m.side[0], 16 // m.side[1] * m.side[1]))
    levels = by_differences(frame, m)
    linear = plain(frame, m, thinned(estimation_weights(m, EVEN, reach_of(m, 1), levels), m))
    np.testing.assert_allclose(demultiplex(frame, m, filter="lmmse", workers=2), linear, atol=1e-11)
    tables = [thinned(estimation_weights(m, p, reach_of(m, 2), levels), m) for p in (ALONG_ROWS, ALONG_COLUMNS)]
    one, two = (plain(frame, m, table) for table in tables)
    change = []
    for estimate, axis in ((one, 2), (two, 1)):
        chroma = estimate - estimate.mean(0)
        change.append(np.abs(np.diff(chroma, axis=axis)).sum(0))
    wanted = np.empty_like(one)
    for y, x in np.ndindex(frame.shape):
        low_y, low_x = max(y - 3, 0), max(x - 3, 0)
        along = change[0][low_y : y + 4, max(x - 4, 0) : x + 4].sum()
        down = change[1][max(y - 4, 0) : y + 4, low_x : x + 4].sum()
        wanted[:, y, x] = (one[:, y, x] * down**4 + two[:, y, x] * along**4) / (along**4 + down**4)
    for workers in (1, 3):
        found = demultiplex(frame, m, filter="directional", workers=workers)
        np.testing.assert_allclose(found, wanted, atol=1e-10)


def test_chunks_of_rows_leave_no_seams() -> None:
    frame = RNG(2).random((150, 24)).astype(np.float32)
    one, many = (demultiplex(frame, cfa("GRBG"), workers=n) for n in (1, 3))
    np.testing.assert_array_equal(one, many)
    np.testing.assert_allclose(one, demultiplex(frame.astype(float), cfa("GRBG"), workers=1), atol=1e-5)


@pytest.mark.parametrize("filter", ["lmmse", "directional"])
def test_even_light_and_small_frames(filter: str) -> None:
    for m in map(cfa, ("Bayer", "CYMG", "RGBW 4x4", "X-Trans", "RGBE", "RGBWCMY/GBRWMYC")):
        for shape in ((m.side[0], m.side[1]), (m.side[0] + 1, 3 * m.side[1] + 1), (23, 31)):
            light = np.array([0.7, 0.2, 0.4])[:, None, None] * np.ones(shape)
            found = demultiplex(multiplex(light, m), m, filter=filter)
            np.testing.assert_allclose(found, light, atol=1e-9, err_msg=m.name)
    frame = RNG(3).random((40, 36))
    one, other = demultiplex(frame, cfa("GRBG"), filter=filter), demultiplex(frame.T, cfa("GBRG"), filter=filter)
    np.testing.assert_allclose(one, other.transpose(0, 2, 1), atol=1e-10, err_msg="rows and columns are alike")


def test_colours_that_are_not_measured_are_0() -> None:
    frame = multiplex(np.array([0.7, 0.2, 0.4])[:, None, None] * np.ones((12, 12)), cfa("RRGG"))
    found = demultiplex(frame, cfa("RRGG"), filter="lmmse")
    np.testing.assert_allclose(found, np.array([0.7, 0.2, 0.0])[:, None, None] * np.ones((3, 12, 12)), atol=1e-9)


def test_a_frame_is_continued_with_pixels_of_the_same_filter() -> None:
    for period, cells in itertools.product((1, 2, 3, 6), (1, 2, 5)):
        n, margin = cells * period, 2 * period + 3
        found = _continued(n, margin, period)
        place = np.arange(-margin, n + margin)
        assert found.min() >= 0 and found.max() < n
        np.testing.assert_array_equal((found - place) % period, 0)
        np.testing.assert_array_equal(found[margin : margin + n], np.arange(n))


def test_defaults_and_refusals() -> None:
    frame = RNG(4).random((24, 24))
    for m, name in ((cfa("X-Trans"), "directional"), (cfa("RRGG"), "cubic"), (mask("MURA", 3), "cubic")):
        np.testing.assert_array_equal(demultiplex(frame, m), demultiplex(frame, m, filter=name))
    np.testing.assert_array_equal(
        demultiplex(frame, cfa("Bayer"), samples=1), demultiplex(frame, cfa("Bayer"), samples=1, filter="cubic")
    )
    for m, options in ((mask("MURA", 3), {}), (cfa("Bayer"), {"samples": 1}), (cfa("Bayer") * mask("lenslet", 3), {})):
        with pytest.raises(InputError, match="colour filter array"):
            demultiplex(frame, m, filter="lmmse", **options)


def halved(file: Path) -> Array:
    """Return a photograph at half its size, free of the demosaicing and compression it went through."""
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    assert image is not None
    h, w = (n // 4 * 2 for n in image.shape[:2])
    return image[: 2 * h, : 2 * w, ::-1].reshape(h, 2, w, 2, 3).mean((1, 3)).transpose(2, 0, 1)


def psnr(found: Array, truth: Array) -> float:
    error = (np.clip(found, 0, 255) - truth)[:, 8:-8, 8:-8]
    return float(10 * np.log10(255**2 / np.mean(error**2)))


def photograph() -> Array:
    return halved(Path(matplotlib.get_data_path()) / "sample_data/grace_hopper.jpg")


def test_a_photograph_is_better_than_by_opencv() -> None:
    image = photograph()
    frame = multiplex(image, cfa("GRBG"))
    whole = np.rint(frame).astype(np.uint8)
    kinds = {"bilinear": "", "edges": "_EA", "VNG": "_VNG"}
    codes = {name: getattr(cv2, f"COLOR_BayerGRBG2RGB{end}") for name, end in kinds.items()}
    theirs = {name: psnr(cv2.demosaicing(whole, code).transpose(2, 0, 1), image) for name, code in codes.items()}
    ours = {
        name: psnr(demultiplex(frame, cfa("GRBG"), filter=name), image) for name in ("cubic", "lmmse", "directional")
    }
    assert ours["directional"] > max(theirs.values()) + 0.3, (ours, theirs)
    assert ours["lmmse"] > theirs["bilinear"] + 2 and ours["lmmse"] > ours["cubic"] + 2


def test_unequal_sensitivities_to_colours_do_not_matter() -> None:
    image = photograph()
    balance = np.array([0.45, 1.0, 0.6])[:, None, None]
    plainly, unequal = (
        demultiplex(multiplex(image * gains, cfa("GRBG")), cfa("GRBG")) / gains for gains in (1.0, balance)
    )
    assert psnr(unequal, image) > psnr(plainly, image) - 0.05
    scaled = demultiplex(1e-30 * multiplex(image * balance, cfa("GRBG")), cfa("GRBG")) / balance * 1e30
    np.testing.assert_allclose(scaled, unequal, atol=1e-6)


def test_mean_psnr_over_six_photographs_is_at_least_that_of_menon() -> None:
    """Menon et al. 2007 with its refining step, as colour-demosaicing has it."""
    roots = {name: importlib.util.find_spec(name) for name in ("skimage", "sklearn", "colour_demosaicing")}
    missing = [name for name, spec in roots.items() if spec is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)} (the images and the comparison come with them)")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it tells of its own optional packages
        from colour_demosaicing import demosaicing_CFA_Bayer_Menon2007 as menon

    ours, theirs = [], []
    for package, name in SIX:
        image = halved(Path(str(roots[package].origin)).parent / name)  # type: ignore[union-attr]
        frame = multiplex(image, cfa("GRBG"))
        ours.append(psnr(demultiplex(frame, cfa("GRBG")), image))
        theirs.append(psnr(menon(frame, "GRBG").transpose(2, 0, 1), image))
    assert np.mean(ours) >= np.mean(theirs), (ours, theirs)
    assert np.mean(theirs) > 33, "the comparison itself must be what it is known for"


ROOT = Path(__file__).resolve().parents[2]
COLOURS = np.array([0.6, 1.0, 0.4])


def kodak() -> tuple[NDArray[np.uint16], str]:
    image = open_image(shared("bayer_raw/RAW_KODAK_DC50.KDC"))
    return image.read(), str(image.metadata["cfa"])


@pytest.mark.long
def test_the_linear_route_on_a_raw_frame_is_bilinear_demosaicing_of_opencv() -> None:
    frame, pattern = kodak()
    assert pattern == "GRBG"
    ours = demultiplex(frame, cfa(pattern), filter="linear")
    theirs = cv2.demosaicing(frame, cv2.COLOR_BayerGRBG2RGB).transpose(2, 0, 1).astype(float)
    inner = (slice(4, -4), slice(4, -4))
    for k in (0, 2):  # red and blue: the same bilinear interpolation, OpenCV rounds to whole numbers
        assert np.abs(ours[k] - theirs[k])[inner].max() <= 0.76
    # green: OpenCV takes the four neighbours and keeps recorded greens; here both green channels are averaged
    green = np.zeros(frame.shape, bool)
    green[0::2, 0::2] = green[1::2, 1::2] = True
    weight, hat = np.where(green, 4.0, 0.0), np.array([1, 2, 1]) / 4.0
    smooth, mean = (cv2.sepFilter2D(one, -1, hat, hat) for one in (weight * frame, weight))
    np.testing.assert_allclose(ours[1][inner], (smooth / mean)[inner], rtol=1e-4)
    wrong = demultiplex(frame, cfa("RGGB"), filter="linear")
    assert np.abs(wrong[0] - theirs[0])[inner].mean() > 10 * np.abs(ours[0] - theirs[0])[inner].mean()


@pytest.mark.long
def test_routes_on_a_raw_frame() -> None:
    frame, pattern = kodak()
    cubic, fourier, bilateral = (
        demultiplex(frame.astype(np.float32), cfa(pattern), **o)
        for o in ({}, {"route": "fourier"}, {"filter": "bilateral"})
    )
    span = np.ptp(frame)
    assert np.sqrt(np.mean((cubic - fourier) ** 2)) / span < 0.03
    # a real frame is not band-limited: the Fourier route runs beyond the recorded values more often
    beyond = [np.mean((r > frame.max()) | (r < frame.min())) for r in (bilateral, cubic, fourier)]
    assert beyond[0] < 1e-6 and beyond[0] <= beyond[1] < beyond[2]
    with rawpy.imread(str(shared("bayer_raw/RAW_KODAK_DC50.KDC"))) as raw:
        plain = {"gamma": (1, 1), "no_auto_bright": True, "use_camera_wb": False, "user_wb": [1, 1, 1, 1]}
        algorithm, colours = rawpy.DemosaicAlgorithm.LINEAR, rawpy.ColorSpace.raw
        libraw = raw.postprocess(demosaic_algorithm=algorithm, output_bps=16, output_color=colours, **plain)
        libraw = libraw.transpose(2, 0, 1).astype(float)
    for ours, theirs in zip(demultiplex(frame, cfa(pattern), filter="linear"), libraw, strict=True):
        if ours.shape == theirs.shape:
            assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.98


def test_views_of_a_measured_light_field() -> None:
    light, white, dark = (
        read_image(shared(f"lfm_guv/{name}_GUVExperim1.tif")).astype(np.float32)
        for name in ("Lightfield", "Radiometry", "DarkFrame")
    )
    lattice = fit_lattice(white - dark)
    assert lattice.pitch_px == pytest.approx(15.39, abs=0.03)
    views = lattice_channels(light - dark, lattice, 13, filter="cubic")
    middle = views[6, 6]
    theirs = extract_views(light, lattice, dark=dark, radius_px=6.0, axes="lattice")
    linear = lattice_channels(light - dark, lattice, 13)
    np.testing.assert_allclose(linear, theirs.images, atol=1e-4 * float(np.ptp(theirs.images)))
    # neighbouring views show the same vesicle
    near = np.corrcoef(middle.ravel(), views[6, 7].ravel())[0, 1]
    far = np.corrcoef(middle.ravel(), views[0, 0].ravel())[0, 1]
    assert near > 0.95 and near > far
    # a view of the white frame is even; of the nominal pitch it shows the lattice drifting by
    off = SuperPixelLattice("square", lattice.origin_px, (15.0, 0.0), (0.0, 15.0))
    even, uneven = (lattice_channels(white - dark, at, 13)[6, 6] for at in (lattice, off))
    assert even.std() / even.mean() < 0.1 < 3 * even.std() / even.mean() < uneven.std() / uneven.mean()


def bayer_session(step: int, blur_px: float) -> tuple[ArraySource, ArraySource, tuple[int, int, int]]:
    """Return frames of the sample session, every ``step``-th position, as a mono and as a Bayer sensor see them."""
    folder = ROOT / "sample_data" / "session"
    if not folder.exists():
        pytest.skip("needs sample_data/session")
    recorded = open_frames(folder / "frames")
    shape = (1, 2, 3)
    frames = np.empty((*shape, *recorded.shape))
    for k in range(len(recorded)):
        z, y, x = recorded.info(k).position
        if z == 0 and y % step == x % step == 0 and y < 2 * step and x < 3 * step:
            frame = recorded.read(k) - 64.0
            frames[z, y // step, x // step] = cv2.GaussianBlur(frame, (0, 0), blur_px) if blur_px else frame
    mosaics = np.empty_like(frames)
    for at in np.ndindex(shape):
        mosaics[at] = multiplex(COLOURS[:, None, None] * frames[at], cfa("GRBG"))
    return ArraySource(frames), ArraySource(mosaics, metadata={"cfa": "GRBG"}), shape


def test_h_of_each_channel_of_bayer_frames() -> None:
    """Steps of two pixels are steps of one in a channel: H of each channel is that of the mono sensor, thinned."""
    mono, mosaic, shape = bayer_session(2, 0.0)
    for k, (channel, row, column) in {1: ("G1", 0, 0), 0: ("R", 0, 1), 2: ("B", 1, 0)}.items():
        H = np.asarray(assemble(channel_source(mosaic, channel), shape, Cutout((21, 21), anchor=(20, 22))).matrix)
        for y, x in np.ndindex(2, 3):
            frame = mono.read(3 * y + x)[row::2, column::2]
            cut = frame[20 + y - 10 : 20 + y + 11, 22 + x - 10 : 22 + x + 11]
            np.testing.assert_allclose(H[0, y, x], COLOURS[k] * cut, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize(("blur_px", "most"), [(1.5, 0.1), (2.0, 0.045)])
def test_h_of_demosaiced_bayer_frames(blur_px: float, most: float) -> None:
    """By a linear filter that mixes no colours: right where spots are wider than the pattern, not for sharp ones."""
    cutout = Cutout((41, 41), anchor=(39, 47))

    def errors(blur: float) -> list[float]:
        mono, mosaic, shape = bayer_session(1, blur)
        truth = np.asarray(assemble(mono, shape, cutout).matrix)
        frames = [mosaic.read(k).astype(np.float32) for k in range(len(mosaic))]
        light = [demultiplex(frame, cfa("GRBG"), filter="cubic") for frame in frames]
        found = [
            np.asarray(assemble(ArraySource(np.stack(c).reshape(*shape, *mosaic.shape)), shape, cutout).matrix)
            for c in zip(*light, strict=True)
        ]
        return [
            float(np.linalg.norm(H / w - truth) / np.linalg.norm(truth)) for H, w in zip(found, COLOURS, strict=True)
        ]

    assert max(errors(blur_px)) < most
    assert min(errors(0.0)) > 0.5, "spots of one pixel fall between the samples of a colour"
