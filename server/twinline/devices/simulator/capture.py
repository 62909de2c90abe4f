"""A simulated laser pass as a capture folder: the same files that a real machine's owner would bring, and the truth."""

import os
from collections.abc import Callable, Iterator
from collections.abc import Set as AbstractSet
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from twinline.arrays import FloatArray
from twinline.devices.simulator.capture_parts import checked_parts, described_parts, write_parts
from twinline.devices.simulator.machine import SimulatedRig
from twinline.devices.simulator.renderer import Renderer, RoomLight
from twinline.devices.simulator.scenes import Scene, named_scene
from twinline.devices.simulator.truth import owner_knowledge, write_json, write_truth
from twinline.devices.simulator.workspace import Workspace, swept_travel_mm
from twinline.errors import OutputError, SettingsError

_CHUNK_FRAMES = 16
_FRAMES_PER_SECOND = 25.0
_MAX_FRAMES = 100_000
_JPEG_QUALITY = 90

Lasers = frozenset[int]


@dataclass(frozen=True, eq=False)
class RenderedCapture:
    """What was rendered.

    Attributes
    ----------
    cart_mm : (frames,) array
        Commanded positions of the frames.
    scene
        As it lies in the bed frame of ``rig.json``.
    """

    folder: Path
    cart_mm: FloatArray
    scene: Scene
    rig: SimulatedRig


@dataclass(frozen=True)
class _Shot:
    number: int
    cart_mm: float
    lasers: Lasers


def _nothing(*_: object) -> None:
    return


def render_capture(
    folder: Path,
    scene: str | Scene = "three-objects",
    *,
    rig: SimulatedRig | None = None,
    image_size: tuple[int, int] | None = None,
    pitch_mm: float = 0.5,
    travel_mm: tuple[float, float] | None = None,
    alternating: bool = False,
    parts: AbstractSet[str] = frozenset(),
    room: RoomLight | None = None,
    seed: int = 0,
    executor: Executor | None = None,
    report: Callable[[int, int], None] = _nothing,
    checkpoint: Callable[[], None] = _nothing,
) -> RenderedCapture:
    """Scan a scene with a simulated machine and write the capture folder.

    The folder receives ``laser/`` with its ``frames.csv`` and ``off.jpg``, the truth (``rig.json``, ``truth.json``,
    ``truth.ply``) and, last of all, ``capture.json``: an interrupted folder is not taken for a capture.

    Parameters
    ----------
    folder
        Made where it does not exist; it must not hold a capture yet.
    scene
        Name of a built-in scene, or one of your own, placed about the origin; it is moved along the travel so that the
        pass begins at the commanded position 0.
    rig
        The machine; by default one that is misaligned in every way a real one is.
    image_size : (int, int)
        Width and height of the part of the sensor that is read out, about its middle; by default all of it.
    pitch_mm
        Commanded millimetres from frame to frame.
    travel_mm : (float, float)
        Commanded positions of the first and of the last frame; by default as far as it takes every laser to sweep the
        whole scene.
    parts
        What to write beside the laser pass: "camera" (views of a calibration board), "motion" (a board on the bed
        while the cart travels), "tof" (a ToF pass).
    alternating
        Only one laser on at a time, frame by frame.
    executor
        Where frames are rendered: threads or processes. None takes threads of its own on all cores; rendering holds
        no interpreter lock.
    report
        Called with (done, total) frames, in the calling thread.
    checkpoint
        Called between chunks of frames in the calling thread; what it raises ends the work.

    Raises
    ------
    NotFoundError
        There is no such scene.
    SettingsError
        A pitch, range or image size makes no sense.
    OutputError
        The folder cannot be written, or holds a capture already.
    """
    machine = rig or SimulatedRig()
    if image_size is not None:
        machine = machine.cropped(image_size)
    chosen = named_scene(scene) if isinstance(scene, str) else scene
    first_mm, last_mm = swept_travel_mm(machine, chosen)
    placed = chosen.moved(-first_mm, 0.0)
    cart_mm = _positions(travel_mm or (0.0, last_mm - first_mm), pitch_mm)
    wanted = checked_parts(frozenset(parts), machine)
    workspace = Workspace(placed, machine, room or RoomLight(), seed)
    renderer = workspace.renderer

    every = frozenset(range(1, len(machine.lasers) + 1))
    shots = [
        _Shot(number, float(mm), frozenset({number % len(every) + 1}) if alternating else every)
        for number, mm in enumerate(cart_mm)
    ]
    with _writing(folder):
        if (folder / "capture.json").exists():
            raise OutputError(f"{folder} already holds a capture; choose another folder or remove it.")
        (folder / "laser").mkdir(parents=True, exist_ok=True)
        _write_picture(folder / "laser" / "off.jpg", renderer, _Shot(len(shots), float(cart_mm[0]), frozenset()))
        _render_all(folder, renderer, shots, executor, report, checkpoint)
        _write_frame_list(folder / "laser" / "frames.csv", shots, alternating=alternating)
        write_truth(folder, placed, machine, name=placed.name, seed=seed)
        write_parts(folder, wanted, workspace, seed=seed, checkpoint=checkpoint)
        write_json(folder / "capture.json", owner_knowledge(placed.name, machine) | described_parts(wanted, machine))
    return RenderedCapture(folder, cart_mm, placed, machine)


def _positions(travel_mm: tuple[float, float], pitch_mm: float) -> FloatArray:
    first, last = travel_mm
    if not (np.isfinite([first, last, pitch_mm]).all() and pitch_mm > 0 and last >= first):
        raise SettingsError(
            f"A simulated pass needs a pitch above 0 mm and an end that is not before its start, not {pitch_mm} mm "
            f"from {first} to {last} mm."
        )
    count = int(np.floor((last - first) / pitch_mm + 1e-9)) + 1
    if count > _MAX_FRAMES:
        raise SettingsError(
            f"A pass of {last - first:g} mm at {pitch_mm:g} mm takes {count} frames, more than {_MAX_FRAMES}; "
            "use a larger pitch or a shorter travel."
        )
    return np.asarray(first + pitch_mm * np.arange(count))


def _render_all(
    folder: Path,
    renderer: Renderer,
    shots: list[_Shot],
    executor: Executor | None,
    report: Callable[[int, int], None],
    checkpoint: Callable[[], None],
) -> None:
    """Render chunk by chunk; when anything goes wrong nothing is left running."""
    own = ThreadPoolExecutor(max_workers=os.cpu_count()) if executor is None else None
    pool = own or executor
    assert pool is not None
    report(0, len(shots))
    pending: set[Future[int]] = set()
    try:
        for start in range(0, len(shots), _CHUNK_FRAMES):
            pending.add(pool.submit(_render_chunk, folder, renderer, shots[start : start + _CHUNK_FRAMES]))
        done = 0
        while pending:
            checkpoint()
            finished, pending = wait(pending, timeout=0.2, return_when=FIRST_COMPLETED)
            done += sum(future.result() for future in finished)
            if finished:
                report(done, len(shots))
    finally:
        for future in pending:
            future.cancel()
        wait(pending)
        if own is not None:
            own.shutdown()


def _render_chunk(folder: Path, renderer: Renderer, shots: list[_Shot]) -> int:
    for shot in shots:
        _write_picture(folder / "laser" / _file_name(shot), renderer, shot)
    return len(shots)


def _write_picture(path: Path, renderer: Renderer, shot: _Shot) -> None:
    picture = renderer.render(shot.number, shot.cart_mm, shot.lasers)
    encoded, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not encoded:
        raise OutputError(f"The simulated picture {path} could not be encoded as JPEG; try another image size.")
    path.write_bytes(data.tobytes())


def _file_name(shot: _Shot) -> str:
    return f"{shot.number:06d}.jpg"


def _write_frame_list(path: Path, shots: list[_Shot], *, alternating: bool) -> None:
    lines = ["frame,time_s,cart_mm" + (",lasers" if alternating else "")]
    for shot in shots:
        names = "," + "".join(str(number) for number in sorted(shot.lasers)) if alternating else ""
        lines.append(f"{_file_name(shot)},{shot.number / _FRAMES_PER_SECOND:.4f},{shot.cart_mm:.4f}{names}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"The simulated capture cannot be written to {error.filename or folder}: {error.strerror or error}; "
            "choose a folder that can be written, with enough free space."
        ) from error
