"""What is subtracted from frames must be their level: more or less of it is no figure of H."""

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.psf._pedestal import pedestal_share
from lfcal.psf.assembly import AssemblySettings, find_plan_cutout
from lfcal.psf.cutout import Gatherer
from tests.psf.test_orientation import a_plan, upright


@pytest.fixture(scope="module")
def scan():
    plan = a_plan((60, 72), (3, 4), (25.0, 30.0), 2, (25, 25))
    frames, places = upright(plan, width=4.0, noise=2.0)
    return plan, ArraySource(np.rint(frames).astype(np.uint16), places)


@pytest.mark.parametrize("off", [-50.0, -10.0, 10.0, 200.0, 1500.0])
def test_a_wrong_level_is_refused_with_its_size(scan, off):
    plan, frames = scan
    view = corrected_view(frames, CorrectionRecipe(black_level=100.0 + off), plan)
    with pytest.raises(InputError, match=r"after subtracting the dark or black level\); give dark frames") as told:
        find_plan_cutout(view, plan, AssemblySettings())
    said = float(str(told.value).split("a constant level of ")[1].split(" (")[0])
    assert said == pytest.approx(-off, abs=0.3)
    assert ("more than all their light" in str(told.value)) == (off > 100)
    find_plan_cutout(view, plan, AssemblySettings(keep_pedestal=True))
    border = corrected_view(frames, CorrectionRecipe(black_level=100.0 + off, background="border"), plan)
    find_plan_cutout(border, plan, AssemblySettings())


@pytest.mark.parametrize("off", [-0.4, 0.0, 0.4])
def test_a_level_that_is_right_but_for_its_rounding_passes(scan, off):
    plan, frames = scan
    view = corrected_view(frames, CorrectionRecipe(black_level=100.0 + off), plan)
    cutout = find_plan_cutout(view, plan, AssemblySettings())
    infos = tuple(view.info(k) for k in range(len(view)))
    level, _, seen = pedestal_share(Gatherer(view, infos, cutout), [0, 1])
    assert seen and level == pytest.approx(-off, abs=0.15)  # the median of whole numbers would be one


def test_a_mosaic_whose_colours_do_not_come_back_is_refused(scan):
    plan, frames = scan
    recipe = CorrectionRecipe(black_level=100.0)

    def chosen(cfa, period):
        sensor = replace(plan.camera.sensor, cfa=cfa)
        seen = replace(plan, camera=replace(plan.camera, sensor=sensor), period=period)
        return find_plan_cutout(corrected_view(frames, recipe, seen), seen, AssemblySettings(strict=False))

    with pytest.raises(InputError, match=r"got 3 x 4 pixels, after which the same point .* scan 6 x 4 positions"):
        chosen("RGGB", (3, 4))
    chosen("", (3, 4))
    chosen("RGGB", (2, 4))


def test_noise_alone_is_no_level(scan):
    plan, frames = scan
    rng = np.random.default_rng(0)
    values = np.rint(100 + 2 * rng.standard_normal((len(frames), *frames.shape))).astype(np.uint16)
    dark = ArraySource(values, [frames.info(k).position for k in range(len(frames))])
    find_plan_cutout(corrected_view(dark, CorrectionRecipe(black_level=100.0), plan), plan, AssemblySettings())


@pytest.mark.parametrize(("off", "refused"), [(0.0, False), (-1.5, True)])
def test_the_darkest_part_of_dim_cutouts_is_noise_unless_it_is_certain(off, refused):
    # frames that are cutouts have no place without light: the darkest of 64 blocks counts, and noise makes it negative
    plan = a_plan((200, 200), (1, 1), (100.0, 100.0), 3, (181, 181))
    frames, places = upright(plan, width=2.0, noise=3.0)
    dim = (frames - 100.0) * 0.5 + 100.0 + off
    rng = np.random.default_rng(0)
    frames = [np.rint(np.clip(one + 3.0 * rng.standard_normal(one.shape), 0, None)).astype(np.uint16) for one in dim]
    view = corrected_view(ArraySource(np.stack(frames), places), CorrectionRecipe(black_level=100.0), plan)
    cutout = find_plan_cutout(view, plan, AssemblySettings(keep_pedestal=True))
    gatherer = Gatherer(view, tuple(view.info(k) for k in range(len(view))), cutout)
    found = [pedestal_share(gatherer, [k]) for k in range(len(view))]
    assert not any(seen for _, _, seen in found)
    assert all((level < 0) == refused for level, _, _ in found)
