"""What there is to drive: a real machine, a simulated one, or a recording; the place where they are put together."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinline.devices.board import Board
from twinline.devices.camera import Camera
from twinline.devices.cameras.opening import open_camera
from twinline.devices.replay.board import ReplayBoard
from twinline.devices.replay.camera import ReplayCamera
from twinline.devices.replay.machine import machine_for
from twinline.devices.replay.playback import open_playback
from twinline.devices.serial.driver import SerialBoard
from twinline.devices.serial.port import port
from twinline.devices.serial.protocol_gen import ADC_CLIP_HIGH, ADC_CLIP_LOW, ADC_FULL_SCALE
from twinline.devices.simulator.cable import InProcessCable
from twinline.devices.simulator.camera import SimulatedCamera
from twinline.devices.simulator.simulated_board import MachineSettings, SimulatedBoard
from twinline.devices.simulator.tof import FrontEnd, TofSensor
from twinline.devices.simulator.truth import owner_knowledge
from twinline.devices.simulator.workspace import Workspace, WorkspaceAdc
from twinline.errors import CaptureError
from twinline.geometry.rig import Rig
from twinline.operations.passes.machine import Machine, Replayed
from twinline.operations.passes.requests import LaserPassRequest, ScanRequest, TofPassRequest
from twinline.operations.passes.scan_folder import recorded_requests
from twinline.recording.pass_messages import Picture
from twinline.recording.pass_reader import Recording

ADC_COUNTS = 4096
ADC_PER_COUNT = ADC_FULL_SCALE / (ADC_COUNTS - 1)
_TOF_MARGIN_MM = 6.0


def real_board(url: str) -> Board:
    """A board with the protocol of firmware/protocol; nothing is touched before it is opened.

    Parameters
    ----------
    url
        A serial device such as ``/dev/ttyACM0``, or any URL of pyserial's.
    """
    return SerialBoard(port(url))


def real_camera(url: str) -> Camera:
    """A camera by its address: ``uvc:0``, ``rtsp://``, ``http://``, a video file, a folder of pictures.

    Raises
    ------
    SettingsError
        There is no kind of camera with such an address.
    """
    return open_camera(url)


def real_machine(board: str, camera: str, description: Path, rig: Rig | None) -> Machine:
    """A machine of real devices.

    Parameters
    ----------
    description
        A ``capture.json`` that describes the scanner.

    Raises
    ------
    CaptureError
        The description cannot be read or is malformed.
    SettingsError
        There is no kind of camera with such an address.
    """
    try:
        text = description.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{description} cannot be read: {error}; give the capture.json of this scanner.") from error
    machine = Machine(
        real_board(board),
        real_camera(camera),
        text,
        rig,
        adc_per_count=ADC_PER_COUNT,
        adc_valid=(ADC_CLIP_LOW, ADC_CLIP_HIGH),
    )
    machine.info()
    return machine


@dataclass(frozen=True, eq=False)
class SimulatedMachine:
    """A simulated machine with its insides, whose faults can be switched on. Made under a running event loop.

    Attributes
    ----------
    machine
        What the passes drive: the serial driver at the end of a simulated cable, and the simulated camera.
    workspace
        What lies on its bed, with the truth.
    board, camera, adc
        The simulated devices themselves.
    """

    machine: Machine
    workspace: Workspace
    board: SimulatedBoard
    camera: SimulatedCamera
    adc: WorkspaceAdc

    def close(self) -> None:
        """Switch it off."""
        self.board.close()


def prepare(workspace: Workspace) -> None:
    """Do what takes seconds the first time: afterwards camera and sensor keep up with a machine in real time.

    It is for a thread: a loop that is held up for half a second misses the board's heartbeat.
    """
    workspace.renderer.render(0, 0.0, frozenset({1, 2}))
    if workspace.rig.tof is not None:
        here = np.zeros(1)
        workspace.tof_adc()(here, here, here)


def simulated_machine(
    workspace: Workspace,
    *,
    rig: Rig | None = None,
    settings: MachineSettings | None = None,
    rate_hz: float = 25.0,
    seed: int = 0,
) -> SimulatedMachine:
    """A machine over a workspace; without ``rig`` it comes calibrated with its own truth."""
    adc = workspace.tof_adc()
    board = SimulatedBoard(settings, adc=adc)
    camera = SimulatedCamera(workspace, board, rate_hz=rate_hz)
    driver = SerialBoard(InProcessCable(board, seed=seed).connect)
    machine = Machine(
        driver,
        camera,
        json.dumps(describe(workspace), indent=1),
        rig or workspace.true_rig(),
        simulated=True,
        adc_per_count=ADC_PER_COUNT,
        adc_valid=(ADC_CLIP_LOW, ADC_CLIP_HIGH),
    )
    return SimulatedMachine(machine, workspace, board, camera, adc)


@dataclass(frozen=True, eq=False)
class ReplayedMachine:
    """A recording as a machine. Made under a running event loop.

    Attributes
    ----------
    machine
        What the passes drive.
    requests
        The passes that were recorded, as they were asked for; None where there was none.
    """

    machine: Machine
    requests: ScanRequest
    _stand_in: SimulatedBoard

    def close(self) -> None:
        """Switch off the machine that stands in for what was not recorded."""
        self._stand_in.close()


def replayed_machine(recording: Path, *, speed: float = 1.0) -> ReplayedMachine:
    """A recording, or the folder of a scan's recordings, as a machine: what its passes give is what they gave then.

    Parameters
    ----------
    speed
        Seconds of the recording in a second of the loop; infinite for as fast as it can be read.

    Raises
    ------
    CaptureError
        It is no recording of a pass.
    RigError
        The rig in it cannot be read.
    """
    playback = open_playback(recording, speed=speed, armed=True)
    board, stand_in = machine_for(playback)
    header = playback.recordings[0].header
    machine = Machine(
        ReplayBoard(playback, board),
        ReplayCamera(playback),
        header.capture,
        header.read_rig(),
        simulated=bool(header.settings.get("simulated")),
        adc_per_count=header.adc_per_count,
        adc_valid=header.adc_valid,
        replayed=Replayed(_background(playback.recordings)),
    )
    return ReplayedMachine(machine, recorded_requests(playback.recordings), stand_in)


def _background(recordings: Sequence[Recording]) -> Picture | None:
    frame = next((frame for recording in recordings for frame in recording.parts.get("laser/off", ())), None)
    if frame is None:
        return None
    at = frame.picture.at
    return Picture(
        "laser/off", -1, frame.picture.name, at.encoding, frame.picture.raw_bytes(), at.size, frame.host_time_s,
        frame.sequence, frame.exposure_s, frame.dropped, frame.lasers, frame.cart_mm,
    )  # fmt: skip


def describe(workspace: Workspace) -> Mapping[str, object]:
    """``capture.json`` of a simulated machine: what its owner knows, converter and front end included."""
    description = owner_knowledge(workspace.scene.name, workspace.rig)
    mount = workspace.rig.tof
    if mount is not None:
        description["tof"] = tof_description(TofSensor(), FrontEnd(), mount.known_mm)
    return description


def tof_description(
    sensor: TofSensor, front_end: FrontEnd, mount_mm: tuple[float, float, float]
) -> Mapping[str, object]:
    """The field ``tof``, with the voltages and distances that belong to the first and the last count."""
    volts = [(v - front_end.offset_volts) / front_end.gain for v in (0.0, front_end.reference_volts)]
    span = [sensor.range_mm[0] + (v - sensor.volts[0]) / sensor.volts_per_mm for v in volts]
    return {
        "range_mm": [round(mm, 4) for mm in span],
        "volts": [round(v, 5) for v in volts],
        "adc_counts": front_end.counts,
        "mount_mm": list(mount_mm),
    }


def laser_request_over(workspace: Workspace, speed_mm_s: float, *, alternating: bool = False) -> LaserPassRequest:
    """A laser pass over everything on a simulated bed."""
    first, last = workspace.laser_pass_mm
    return LaserPassRequest(round(float(first), 1), round(float(last), 1), speed_mm_s, alternating)


def tof_request_over(workspace: Workspace, advance_mm: float, speed_mm_s: float) -> TofPassRequest | None:
    """A ToF pass over everything on a simulated bed; None for a machine without sensor."""
    mount = workspace.rig.tof
    if mount is None:
        return None
    low, high = workspace.scene.span_mm
    lows = [thing.mesh.bounds[0][1] for thing in workspace.scene.things]
    highs = [thing.mesh.bounds[1][1] for thing in workspace.scene.things]
    across = (float(min(lows)), float(max(highs))) if lows else (-40.0, 40.0)
    least, most = mount.slide_range_mm
    near = np.clip(across[0] - _TOF_MARGIN_MM - mount.known_mm[1], least + 1.0, most - 1.0)
    far = np.clip(across[1] + _TOF_MARGIN_MM - mount.known_mm[1], least + 1.0, most - 1.0)
    return TofPassRequest(
        round(float(low) - mount.known_mm[0] - _TOF_MARGIN_MM, 1),
        round(float(high) - mount.known_mm[0] + _TOF_MARGIN_MM, 1),
        round(float(near), 1),
        round(float(far), 1),
        advance_mm,
        speed_mm_s,
    )
