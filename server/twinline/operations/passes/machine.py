"""A whole machine as the passes see it: a board, a camera, and what is known of both."""

from dataclasses import dataclass
from pathlib import Path

from twinline.devices.board import Board
from twinline.devices.camera import Camera
from twinline.geometry.rig import Rig
from twinline.recording.capture_json import CaptureInfo, parse_capture_json
from twinline.recording.pass_messages import Picture


@dataclass(frozen=True, eq=False)
class Replayed:
    """That a machine is a recording, and what of it no device plays.

    Attributes
    ----------
    background
        The frame with the lasers off; None where none was recorded.
    """

    background: Picture | None


@dataclass(frozen=True, eq=False)
class Machine:
    """What a scan is made with.

    Attributes
    ----------
    board, camera
        Real, simulated or replayed.
    description
        Text of the ``capture.json`` that describes the scanner.
    rig
        The calibration in use; None where there is none yet.
    simulated
        Whether nothing of it is real.
    adc_per_count
        What the board's readings of the distance sensor are divided by to give the counts of ``description``.
    adc_valid
        Readings outside are none: the sensor saw nothing within its range.
    replayed
        For a machine that is a recording: it makes no frames of its own, and its passes end as they ended then.
    """

    board: Board
    camera: Camera
    description: str
    rig: Rig | None
    simulated: bool = False
    adc_per_count: float = 16.0
    adc_valid: tuple[float, float] | None = None
    replayed: Replayed | None = None

    def info(self) -> CaptureInfo:
        """The scanner's description.

        Raises
        ------
        CaptureError
            It is malformed; the field is named.
        """
        return parse_capture_json(self.description.encode(), Path("machine/capture.json"))
