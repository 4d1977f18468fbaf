"""Every metric, with its thresholds, its cost in a reconstruction, and advice.

Costs are reconstruction errors (NRMSE against the ideal H). Those of scan order, dark planes, missing and misplaced
frames, background, truncation, hot pixels and flicker follow reconstructions with the fault put into a simulated H;
the others are estimates that put a metric in its place among them.
"""

from __future__ import annotations

from lfcal.psf.quality.metric import Spec

__all__ = ["SPECS", "spec"]

SPECS: tuple[Spec, ...] = (
    Spec("scan_order", "Order of the scan", "planes off", 0, 0, 2.5, 3.6, "map",
         "Planes in which the spots run over the lattice in another order than the positions say.",
         "Swap or reverse the axes of the scan, or mirror the frames, and assemble again; no new recording is needed.",
         overall="sum"),
    Spec("stage_gain", "Stage step", "px over the cell", 0.35, 1.0, 0.4, 3.5, "map",
         "How far the source runs ahead of the cutout, or behind it, from the first position to the last.",
         "Correct the stage's step (step = pixel / magnification, with its sign) or the magnification; record again."),
    Spec("period", "Period", "px", 0.25, 0.5, 0.5, 2.0, "table",
         "Difference of the recorded period from the camera's lattice.",
         "Record a whole number of lattice periods: the plan of this camera states how many positions that is."),
    Spec("planes_lit", "Dark planes", "planes", 0, 0, 0.55, 1.0, "planes",
         "Planes with hardly any light in them.",
         "Record these planes again; check lamp, shutter and pinhole.", overall="sum", redo=True),
    Spec("depth_order", "Order of planes", "planes off", 0, 0, 0.6, 2.0, "planes",
         "Planes whose spots are spaced as in another plane: the depths do not belong to them.",
         "Sort the planes by depth, or correct the list of depths.", overall="sum"),
    Spec("plane_copies", "Copied planes", "planes", 0, 0, 0.5, 1.0, "planes",
         "Planes that hold the same patterns as another one.",
         "Record these planes again: the stage did not move in depth, or files were copied.", overall="sum", redo=True),
    Spec("seam", "Seam at the wrap", "x", 1.5, 3.0, 0.1, 0.8, "map",
         "Change from the last position to the first over the change between neighbours: 1 where the cell tiles.",
         "The patterns do not repeat with this period: check period, step, drift, and how telecentric the lens is."),
    Spec("missing", "Missing frames", "frames", 0, 0, 1.3, 2.0, "map",
         "Positions without a frame, or with a dark one.", "Record these positions again.",
         overall="sum", redo=True, per_frame=True),
    Spec("duplicates", "Duplicate frames", "frames", 0, 0, 1.2, 2.0, "map",
         "Positions that hold the very same frame as another position.",
         "Record these positions again: the camera repeated a frame, or a file was copied.",
         overall="sum", redo=True, per_frame=True),
    Spec("nonfinite", "Not-a-number", "pixels", 0, 0, 0.3, 3.0, "map",
         "Pixels that are not a number: one of them spoils a whole reconstruction.",
         "Record these positions again, or assemble again with the corrections checked.", overall="sum", redo=True),
    Spec("misplaced", "Misplaced frames", "frames", 0, 0, 0.6, 2.0, "map",
         "Positions whose pattern belongs half a pixel or more from where it is.",
         "Record these positions again; whole rows or columns point at swapped files or a lost stage step.",
         overall="sum", redo=True, per_frame=True),
    Spec("position", "Position error", "px rms", 0.1, 0.3, 0.25, 1.5, "map",
         "Scatter of the lenslet lattice's phase about what the position says.",
         "Check that frames and positions are in step, and that the stage has settled before each exposure."),
    Spec("jitter", "Stage jitter", "px rms", 0.15, 0.35, 0.17, 1.0, "map",
         "Scatter of the source's position about its path, from the patterns' centroids.",
         "Let the stage settle longer, or take up its play from one side; stiffen the mount."),
    Spec("backlash", "Backlash", "px", 0.1, 0.3, 0.17, 1.0, "map",
         "Half the offset between even and odd rows: play of a stage that scans to and fro.",
         "Scan all rows in the same direction, or give the stage's backlash to the plan, and record again."),
    Spec("drift", "Drift", "px over the cell", 0.5, 1.5, 0.2, 1.5, "map",
         "How far the source wandered across its scan direction from the first row to the last.",
         "Let lamp and stage warm up, record faster, or align the stage's axes with the sensor's rows."),
    Spec("pitch", "Lattice pitch", "px over the cell", 0.5, 1.5, 0.1, 1.0, "map",
         "How far the pattern's lattice runs away from the camera's over one cell.",
         "Fit the lattice to a white image and use it as the camera's; check the stage step."),
    Spec("step", "Odd frames", "x", 2.5, 4.0, 0.01, 0.1, "map",
         "Largest change to all four neighbours, over what is usual around it.",
         "Look at these frames; record them again.", redo=True),
    Spec("truncation", "Cut off", "% of plateau", 1.0, 5.0, 0.16, 1.0, "sum",
         "Light on the cutout's edge over the light in the middle of the depth-plane sum.",
         "Assemble again with a larger cutout."),
    Spec("centring", "Centring", "px", 3.0, 8.0, 0.02, 0.3, "sum",
         "Distance of the aperture's centre from the cutout's.",
         "Assemble again with the anchor moved by this much."),
    Spec("snr", "Peak over noise", "", 100.0, 20.0, 0.5, 1.0, "planes",
         "Median peak of the patterns over the noise of a dark pixel.",
         "Expose longer, average more frames, or cool the sensor.", higher_is_better=True),
    Spec("background", "Background", "% of energy", 0.5, 2.0, 0.046, 1.0, "planes",
         "Energy that a constant background adds to a pattern, or takes from it.",
         "Take a dark frame of the same exposure and temperature, and assemble again."),
    Spec("leak", "Stray light", "% of energy", 1.5, 4.0, 0.05, 0.8, "sum",
         "Light outside the pattern, above the background.",
         "Find the leak or ghost in the depth-plane sum, mask it, record again."),
    Spec("clipped", "Clipped at zero", "% of dark pixels", 2.0, 15.0, 0.04, 0.2, "table",
         "Dark pixels that are exactly zero while none is negative: noise was cut off and its mean is now light.",
         "Keep values signed when the dark frame is subtracted, and assemble again."),
    Spec("saturation", "Saturated pixels", "pixels", 2, 10, 0.03, 0.6, "map",
         "Pixels at the top of the sensor's range.",
         "Shorten the exposure or dim the lamp, and record again.", overall="sum", redo=True),
    Spec("flicker", "Flicker", "% rms", 2.0, 5.0, 0.002, 0.2, "map",
         "Scatter of the patterns' energy from position to position.",
         "Stabilise the lamp, or record a reference and normalise by it."),
    Spec("lamp", "Lamp drift", "% over the cell", 3.0, 8.0, 0.01, 0.3, "map",
         "Change of the patterns' energy from the first position to the last.",
         "Let the lamp warm up, or record a reference and normalise by it."),
    Spec("plane_energy", "Energy of planes", "%", 5.0, 15.0, 0.02, 0.5, "planes",
         "Largest deviation of a plane's energy from the trend of the planes.",
         "Record all planes with the same exposure and lamp, or normalise the planes.",),
    Spec("depth", "Depth of planes", "%", 3.0, 8.0, 0.1, 1.0, "planes",
         "Difference of the aperture's size from the one that the plane's depth states, apart from a common scale.",
         "Check the depth of these planes and the camera's working distance and focal length."),
    Spec("tiling", "Tiling over the field", "%", 5.0, 15.0, 0.1, 1.0, "map",
         "Largest difference of control frames, whole periods away, from the same position of the cell.",
         "Use the period that fits best over the field, resample the frames to it, or calibrate regions of their own."),
    Spec("hot_pixels", "Hot or dead pixels", "pixels", 0, 0, 0.010, 0.3, "sum",
         "Pixels that stay lit or dark whatever the position.",
         "Map the sensor's defects with dark and white frames, and assemble again.", overall="sum"),
    Spec("identities", "Identities", "of peak", 1e-6, 1e-4, 0.5, 2.0, "table",
         "Largest difference of sampled entries of HT from H, and of stored depth-plane sums from the patterns'.",
         "The file does not hold what it says: write it again."),
)  # fmt: skip
"""The catalogue, worst consequences first."""

_BY_KEY = {s.key: s for s in SPECS}


def spec(key: str) -> Spec:
    """Return the line of the catalogue named ``key``."""
    return _BY_KEY[key]
