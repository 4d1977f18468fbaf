"""Settings for the corrections applied to frames."""

from __future__ import annotations

import os

from lfcal.records.option import check_record, opt, record

__all__ = ["CorrectionRecipe"]


@record
class CorrectionRecipe:
    """Corrections applied to frames, and the calibration frames they use.

    Two fields depend on the frames. ``channel`` is the colour channel of a mosaic, such as ``"G1"``; if it is empty,
    all pixels are used. ``shift`` is the number of bits by which left-aligned samples are shifted to the right.

    Examples
    --------
    >>> from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    >>> recipe = CorrectionRecipe(dark="session/dark", background="border")
    >>> with open_frames("session/frames") as source:
    ...     print([type(step).__name__ for step in corrected_view(source, recipe).chain.steps])
    ['Dark', 'Background']
    """

    dark: str | os.PathLike[str] = opt(
        "",
        "Dark frame, or a folder of dark frames to average. none: subtract neither recorded dark frames nor the stated "
        "black level.",
        label="Dark frame",
        file="in",
        empty="recorded dark frames, else the stated black level",
    )
    black_level: float | None = opt(
        None,
        "Sample value without light, after the bit shift; subtracted instead of recorded dark frames.",
        unit="counts",
        empty="as stated by file or plan",
    )
    white: str | os.PathLike[str] = opt(
        "", "White image, or a folder of white images to average.", label="White image", file="in", empty="none"
    )
    white_mode: str = opt(
        "field",
        "Divisor of the frames. field: the smooth fall-off of the white image over the field. pixels: the white image, "
        "pixel by pixel.",
        choices=("field", "pixels"),
        needs=("white", ""),
        more=True,
    )
    white_floor: float = opt(
        0.05,
        "Lower limit of the relative brightness of the white image. Frames are never divided by a smaller value.",
        above=0,
        at_most=1,
        needs=("white", ""),
        more=True,
    )
    defects: bool = opt(
        False, "Find defective pixels from all frames, and repair them.", label="Repair defective pixels"
    )
    defect_list: str | os.PathLike[str] = opt(
        "",
        "Defective pixels to repair, for example from the camera manufacturer: a list with one ROW,COLUMN per line, or "
        "an image that is not 0 at these pixels.",
        label="List of defective pixels",
        file="in",
        empty="none",
        more=True,
    )
    mask: str | os.PathLike[str] = opt(
        "",
        "Pixels without information, which stay invalid in H: an image of the sensor that is not 0 at these pixels, or "
        "a list with one ROW,COLUMN per line.",
        label="Mask of pixels",
        file="in",
        empty="none",
        more=True,
    )
    background: str = opt(
        "none",
        "Background to subtract: none, or a number of counts. border: the median of each frame's border. plane: a "
        "plane fitted to each frame's border.",
        unit="counts",
        examples=("none", "border", "plane"),
    )
    exposure: str = opt(
        "auto",
        "Exposure time to which the frames are scaled. auto: the most frequent one, if the exposure times differ. "
        "none: do not scale.",
        unit="s",
        examples=("auto", "none"),
        more=True,
    )
    saturation: float | None = opt(
        None,
        "Sample value at which pixels saturate, after the bit shift.",
        unit="counts",
        empty="as stated by file or plan",
        more=True,
    )
    channel: str = ""
    shift: int = 0

    def __post_init__(self) -> None:
        """Check every value."""
        check_record(self)
