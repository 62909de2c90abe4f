"""When a set of views cannot calibrate a camera, and what to do then."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.bundle import Solution
from twinline.calibration.camera_evidence import Uncertainty
from twinline.calibration.coverage import Coverage
from twinline.calibration.views import BoardView
from twinline.errors import CalibrationError

MIN_VIEWS = 4
MAX_FOCAL_SD = 0.02
MAX_HALVES_SD = 4.0
MIN_VIEWS_PER_HALF = 5
MAX_LENS_SD_SHARE = 0.015
_MIN_TILT_DEG = 10.0
_PLAINLY_TILTED_DEG = 20.0
_WANTED = "Show the board in at least 10 poses: tilted by 20° to 45° to all sides, near and far, and in the corners"


def require_one_size(views: Sequence[BoardView]) -> tuple[int, int]:
    """The size that all pictures have.

    Raises
    ------
    CalibrationError
        ``too-few-views`` if there are none, ``mixed-image-sizes`` if they differ.
    """
    if not views:
        raise CalibrationError(f"There are no views of the board. {_WANTED} of the image.", code="too-few-views")
    sizes = Counter(view.size for view in views)
    common, _ = sizes.most_common(1)[0]
    odd = [view for view in views if view.size != common]
    if odd:
        raise CalibrationError(
            f"The pictures are of different sizes: {odd[0].name} is {odd[0].size[0]} x {odd[0].size[1]} px where "
            f"others are {common[0]} x {common[1]} px; take all with the same settings, or remove the {len(odd)} that "
            "differ.",
            code="mixed-image-sizes",
        )
    return common


def require_views(views: Sequence[BoardView]) -> None:
    """Raise, with the most frequent cause, if fewer than four different views can be used.

    Raises
    ------
    CalibrationError
        ``too-few-views``, ``views-alike``, ``wrong-board``, ``mirrored-board``, ``blurred-views``,
        ``badly-exposed-views``.
    """
    usable = sum(view.usable for view in views)
    if usable >= MIN_VIEWS:
        return
    count = Counter(view.verdict for view in views if not view.usable)
    cause, number = count.most_common(1)[0] if count else ("not-found", 0)
    have = f"Only {usable} of {len(views)} pictures can be used, and {MIN_VIEWS} are needed"
    example = next((view for view in views if view.verdict == cause), None)
    words = f"; {number} because, as in {example.name}: {example.advice}" if example else ""
    if cause == "duplicate":
        raise CalibrationError(
            f"{have}: {number} show the board in the same pose as another one. Move and tilt it between pictures.",
            code="views-alike",
        )
    code = {
        "wrong-size": "wrong-board",
        "mirrored": "mirrored-board",
        "blurred": "blurred-views",
        "over-exposed": "badly-exposed-views",
        "under-exposed": "badly-exposed-views",
    }.get(cause, "too-few-views")
    raise CalibrationError(f"{have}{words}.{'' if words else f' {_WANTED} of the image.'}", code=code)


def require_agreement(trusted: BoolArray) -> None:
    """Raise if too few views agree with each other.

    Raises
    ------
    CalibrationError
        ``views-contradict``.
    """
    if trusted.sum() < max(MIN_VIEWS, 0.6 * len(trusted)):
        raise CalibrationError(
            f"Only {int(trusted.sum())} of {len(trusted)} views fit one camera: the board's size may be wrong, the "
            "board bent, or the zoom or focus changed between pictures. Check these and take the pictures again.",
            code="views-contradict",
        )


def require_focal_length(solution: Solution, doubt: Uncertainty, halves: tuple[float, float], seen: Coverage) -> None:
    """Raise if the views do not determine the focal length, whatever their residuals.

    Raises
    ------
    CalibrationError
        ``focal-length-unobservable``.
    """
    sd = np.sqrt(np.diagonal(doubt.matrix)[:2])
    share = float((sd / solution.theta[:2]).max())
    low, high = sorted(halves)
    tilt = float(np.max(seen.tilts_deg))
    # Two halves have each about twice the variance of the whole.
    apart = (high - low) / (2.0 * float(sd[0]))
    reasons = []
    if share > MAX_FOCAL_SD:
        reasons.append(f"its standard deviation is {100 * share:.1f} % (limit {100 * MAX_FOCAL_SD:g} %)")
    enough = len(seen.tilts_deg) >= 2 * MIN_VIEWS_PER_HALF
    if enough and low < (1 - 3 * MAX_FOCAL_SD) * high and apart > MAX_HALVES_SD:
        reasons.append(f"one half of the views gives {low:.0f} px and the other {high:.0f} px")
    if tilt < _MIN_TILT_DEG:
        reasons.append(f"the board is never tilted by more than {tilt:.0f}°")
    step = (
        "Views nearly parallel to the board cannot tell it from the distance: add views with the board tilted by 20° "
        "to 45° to all sides"
        if tilt < _PLAINLY_TILTED_DEG
        else "Add sharp views with the board tilted by 20° to 45° to all sides, large, and everywhere in the image"
    )
    if reasons:
        raise CalibrationError(
            f"The focal length cannot be determined from these {len(seen.tilts_deg)} views: {' and '.join(reasons)}. "
            f"{step}.",
            code="focal-length-unobservable",
        )


def require_lens(lens_sd: FloatArray, model: str, size: tuple[int, int], seen: Coverage) -> None:
    """Raise if the views leave the lens distortion open somewhere in the image.

    Raises
    ------
    CalibrationError
        ``distortion-unobservable``.
    """
    worst = float(np.nanmax(lens_sd))
    if worst > MAX_LENS_SD_SHARE * size[0]:
        empty = [item.text.lower() for item in seen.advice if item.missing and "tilt" not in item.text.lower()]
        where = f" ({', '.join(empty[:3])})" if empty else ""
        raise CalibrationError(
            f"The lens distortion ({model}) cannot be determined: towards the border of the image it is known to "
            f"{worst:.0f} px only (limit {MAX_LENS_SD_SHARE * size[0]:.0f} px). Show the board there too{where}.",
            code="distortion-unobservable",
        )
