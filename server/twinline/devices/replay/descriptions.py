"""Board and camera as a recording's settings describe them, so that a replay can say what the machine was."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import cast

from twinline.devices.board import DEFAULT_CART, DEFAULT_SLIDE, Axis, BoardInfo, Drive, LaserPass, TofRaster


def board_settings(info: BoardInfo) -> dict[str, object]:
    """What to put into ``PassHeader.settings`` under ``board``."""
    return {**asdict(info), "lasers": sorted(info.lasers)}


def plan_settings(plan: LaserPass | TofRaster) -> dict[str, object]:
    """What to put into ``PassHeader.settings`` under ``plan``; a replay finds the pass by it."""
    settings = asdict(plan)
    if isinstance(plan, LaserPass):
        settings["phases"] = [sorted(phase) for phase in plan.phases]
    return settings


def board_info(settings: Mapping[str, object], name: str) -> BoardInfo:
    """The board of a recording; a default one where the recording does not describe it.

    Parameters
    ----------
    settings
        ``PassHeader.settings``.
    name
        What to call a board that is not described.
    """
    try:
        fields = dict(cast("Mapping[str, object]", settings["board"]))
        drives = cast("Mapping[Axis, Mapping[str, float]]", fields.pop("drives"))
        lasers = cast("list[int]", fields.pop("lasers"))
        known = {axis: Drive(**{key: float(value) for key, value in drive.items()}) for axis, drive in drives.items()}
        return BoardInfo(drives=known, lasers=frozenset(lasers), **fields)  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError, AttributeError):
        drives_then: dict[Axis, Drive] = {"cart": DEFAULT_CART, "slide": DEFAULT_SLIDE}
        return BoardInfo(name, "", "", 0, drives_then, frozenset({1, 2}), has_adc=True, max_telemetry_hz=0)
