"""``twinline scan``: a whole scan without a browser."""

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

import typer

from twinline.cli.progress import progress
from twinline.cli.reconstruct import ALL, ReconstructRequest, run_reconstruct
from twinline.devices.simulator.workspace import build_workspace
from twinline.devices.termination import cancelled_by_sigterm
from twinline.devices.virtual_time import hold, run_virtual
from twinline.errors import CancelledError, InputError
from twinline.machines import laser_request_over, prepare, real_machine, simulated_machine, tof_request_over
from twinline.operations.passes.requests import LaserPassRequest, ScanRequest, TofPassRequest
from twinline.operations.passes.scan import ScanOutcome, continue_scan, recording_folder, run_scan
from twinline.operations.passes.scan_folder import ScanFolder
from twinline.operations.passes.session import Report, ScanSession
from twinline.recording.rig_file import read_rig, write_rig


@dataclass(frozen=True)
class ScanOptions:
    """The options of the command; see its help."""

    output: Path
    board: str | None
    camera: str | None
    description: Path | None
    rig: Path | None
    scene: str
    seed: int
    area: tuple[float, float] | None
    speed_mm_s: float
    rate_hz: float
    alternating: bool
    tof: bool
    tof_area: tuple[float, float, float, float] | None
    tof_advance_mm: float
    tof_speed_mm_s: float
    real_time: bool
    recording: Path | None
    resume: bool
    json: bool

    @property
    def simulated(self) -> bool:
        """Whether no real device is named."""
        return self.board is None and self.camera is None

    @property
    def folder(self) -> Path:
        """Where the recording lies."""
        return self.recording or recording_folder(self.output)


def run_scan_command(options: ScanOptions) -> None:
    """Scan, reconstruct and write the cloud."""
    if options.output.suffix.lower() not in (".ply", ".glb"):
        raise InputError(f"{options.output}: the cloud is written as .ply or .glb; choose one of these endings.")
    if options.output.is_dir():
        raise InputError(f"{options.output} is a folder; give the name of a file for the cloud.")
    folder = ScanFolder.reopen(options.folder) if options.resume else ScanFolder.create(options.folder)
    try:
        with PhaseProgress(quiet=options.json) as progress:
            run = run_virtual if options.simulated and not options.real_time else asyncio.run
            outcome = run(_until_sigterm(_scan(options, folder, progress.report)))
    except (KeyboardInterrupt, asyncio.CancelledError):
        _tell_of_the_end(options)
        raise CancelledError("The scan was ended from outside.") from None
    finally:
        # What failed before its first frame leaves nothing behind.
        with suppress(OSError):
            folder.path.rmdir()
    _tell(options, outcome)
    about = {"recording": str(options.folder), "scan": asdict(outcome)} if options.json else {}
    run_reconstruct(
        ReconstructRequest(
            capture=folder.path,
            output=options.output,
            rig=None,
            method="maximum-likelihood",
            channel="auto",
            sources=ALL,
            every=1,
            ascii=False,
            workers=None,
            json=options.json,
        ),
        about,
    )


class PhaseProgress:
    """A progress bar for each thing that is done, one after another."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet
        self._phase = ""
        self._bars = ExitStack()
        self._tell: Callable[[int, int], None] = lambda _done, _total: None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.close()

    def report(self, phase: str, done: int, total: int) -> None:
        """Take a report of a scan."""
        if phase != self._phase:
            self._phase = phase
            self._bars.close()
            self._tell = self._bars.enter_context(progress(phase[:1].upper() + phase[1:], quiet=self._quiet))
        if total:
            self._tell(done, total)


async def _until_sigterm(scan: Coroutine[Any, Any, ScanOutcome]) -> ScanOutcome:
    """Let what ends the program end the scan first, so that the lasers go off."""
    with cancelled_by_sigterm():
        return await scan


async def _scan(options: ScanOptions, folder: ScanFolder, report: Report) -> ScanOutcome:
    rig = read_rig(options.rig) if options.rig else None
    if not options.simulated:
        if not (options.board and options.camera and options.description):
            raise InputError("A real machine needs --board, --camera and --machine together.")
        request = _request(options)
        machine = real_machine(options.board, options.camera, options.description, rig)
        return await _run(options, ScanSession(machine, folder, report=report), request)
    report("preparing the simulated machine", 0, 0)
    with hold():
        workspace = await asyncio.to_thread(build_workspace, options.scene, seed=options.seed)
        await asyncio.to_thread(prepare, workspace)
    simulated = simulated_machine(workspace, rig=rig, rate_hz=options.rate_hz, seed=options.seed)
    try:
        laser = laser_request_over(workspace, options.speed_mm_s, alternating=options.alternating)
        if options.area:
            laser = replace(laser, from_mm=options.area[0], to_mm=options.area[1])
        tof = tof_request_over(workspace, options.tof_advance_mm, options.tof_speed_mm_s) if options.tof else None
        outcome = await _run(options, ScanSession(simulated.machine, folder, report=report), ScanRequest(laser, tof))
    finally:
        simulated.close()
    write_rig(folder.path / "true-rig.json", workspace.true_rig())
    if workspace.scene.things:
        workspace.export_mesh(folder.path / "truth.ply")
    return outcome


async def _run(options: ScanOptions, session: ScanSession, request: ScanRequest) -> ScanOutcome:
    return await (continue_scan if options.resume else run_scan)(session, request)


def _request(options: ScanOptions) -> ScanRequest:
    """What is asked of a real machine; a scan that is continued knows by itself what it has begun."""
    if options.area is None:
        if options.resume:
            return ScanRequest(None, _tof(options))
        raise InputError("Say where the laser pass begins and ends: --area FROM TO, positions of the cart in mm.")
    laser_request = LaserPassRequest(*options.area, options.speed_mm_s, options.alternating)
    return ScanRequest(laser_request, _tof(options))


def _tof(options: ScanOptions) -> TofPassRequest | None:
    if not options.tof or options.tof_area is None:
        return None
    return TofPassRequest(*options.tof_area, options.tof_advance_mm, options.tof_speed_mm_s)


def _tell(options: ScanOptions, outcome: ScanOutcome) -> None:
    for check in outcome.checks:
        if check.grade != "good":
            typer.echo(f"twinline: {check.name}: {check.detail}", err=True)
    for warning in outcome.warnings:
        typer.echo(f"twinline: {warning}", err=True)
    if not options.json:
        typer.echo(f"{outcome.frames} frames, {outcome.rows} ToF rows: {options.folder}")


def _tell_of_the_end(options: ScanOptions) -> None:
    """What is left, after Ctrl-C or SIGTERM."""
    if not any(options.folder.glob("*.mcap")):
        typer.echo("twinline: The scan was ended before anything was recorded.", err=True)
        return
    # A simulated machine ends with the program, and with it the knowledge where its cart stands.
    go_on = "" if options.simulated else "go on with --resume, or "
    typer.echo(
        f"twinline: The scan was ended and the lasers are off; what was recorded is in {options.folder}: {go_on}make "
        "points of it with `twinline reconstruct`.",
        err=True,
    )
