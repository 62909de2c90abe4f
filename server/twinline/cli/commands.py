"""The commands and their options; what they do stands in the modules beside this one."""

import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from twinline import __version__
from twinline.errors import CancelledError, TwinlineError

app = typer.Typer(
    name="twinline",
    help="Control server for a cart scanner with twin line lasers, a camera and a ToF sensor.",
    no_args_is_help=False,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Method = Annotated[str, typer.Option("--method", help="How stripe centres are found (see `twinline stripes --help`).")]
Channel = Annotated[
    str, typer.Option("--channel", help="Light to measure: auto, gray, luma, red, green, blue or red-blue.")
]
Json = Annotated[bool, typer.Option("--json", help="Print a summary for machines on standard output.")]


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    """Without a command: start the server on the simulated scanner."""
    if version:
        typer.echo(f"twinline {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        _serve({})


@app.command()
def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on; loopback unless told otherwise.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on.")] = None,
    data_dir: Annotated[Path | None, typer.Option(help="Folder for captures, scans and jobs.")] = None,
) -> None:
    """Start the server; its panel opens at http://127.0.0.1:8080."""
    given = {"host": host, "port": port, "data_dir": data_dir}
    _serve({name: value for name, value in given.items() if value is not None})


def _serve(overrides: dict[str, Any]) -> None:
    from twinline.app import serve as run
    from twinline.settings import load_settings

    run(load_settings(**overrides))


@app.command()
def stripes(
    images: Annotated[list[Path], typer.Argument(help="Pictures with one or two laser stripes, or recordings.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="CSV to write.")],
    method: Method = "maximum-likelihood",
    channel: Channel = "auto",
    runs: Annotated[str, typer.Option(help="along-u (one crossing per column), along-v (per row), or auto.")] = "auto",
    lasers: Annotated[str, typer.Option(help="Stripes to look for: 1, 2 or auto.")] = "auto",
    off: Annotated[Path | None, typer.Option(help="The same view with the lasers off; it is subtracted.")] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            help="Noise model n,K,C: read noise (DN), electrons per DN, speckle contrast. Estimated if absent."
        ),
    ] = None,
    overlay: Annotated[Path | None, typer.Option(help="Folder for pictures with the stripes drawn in.")] = None,
    json: Json = False,
) -> None:
    """Find laser stripes in pictures, to a fraction of a pixel.

    Writes image,laser,u,v,sd_px,amplitude,width_px,flags with one line per stripe and column (row, for stripes along
    v). Of two stripes laser 1 is the one at larger v (u). Methods: maximum-likelihood, gaussian, centre-of-gravity,
    steger, brightest-pixel.
    """
    from twinline.cli.stripes import StripesRequest, run_stripes

    run_stripes(StripesRequest(tuple(images), output, method, channel, runs, lasers, off, noise, overlay, json))


@app.command()
def reconstruct(
    capture: Annotated[Path, typer.Argument(help="Capture folder or recording.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Cloud to write: .ply or .glb.")],
    rig: Annotated[
        Path | None, typer.Option(help="Calibrated rig; else the capture's own, else the nominal rig.")
    ] = None,
    method: Method = "maximum-likelihood",
    channel: Channel = "auto",
    sources: Annotated[str, typer.Option(help="What to use: some of laser1,laser2,tof; or all there are.")] = "all",
    every: Annotated[int, typer.Option(min=1, help="Use each n-th frame.")] = 1,
    ascii_: Annotated[bool, typer.Option("--ascii", help="Write the PLY as text.")] = False,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; all cores if absent.")] = None,
    align: Annotated[
        str, typer.Option(help="none, or thesis: move laser 1 and the ToF cloud by Nelder-Mead before fusing.")
    ] = "none",
    fill: Annotated[
        bool, typer.Option("--fill", help="Close small gaps with points from around them, marked as source 5.")
    ] = False,
    json: Json = False,
) -> None:
    """Turn laser pass and ToF pass of a capture folder or a recording into one point cloud in millimetres."""
    from twinline.cli.reconstruct import ReconstructRequest, run_reconstruct

    wanted = frozenset(name.strip() for name in sources.split(",") if name.strip())
    run_reconstruct(
        ReconstructRequest(capture, output, rig, method, channel, wanted, every, ascii_, workers, json, align, fill)
    )


@app.command()
def calibrate(
    capture: Annotated[Path, typer.Argument(help="Capture folder or recording; whatever parts of it exist are used.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="rig.json to write.")],
    only: Annotated[str, typer.Option(help="Parts to calibrate: camera,travel,sheets,tof; all if empty.")] = "",
    start: Annotated[Path | None, typer.Option(help="Rig that holds the parts that are not calibrated.")] = None,
    method: Annotated[
        str, typer.Option(help="joint (everything together) or thesis (Nelder-Mead on two numbers per laser).")
    ] = "joint",
    picks: Annotated[
        Path | None, typer.Option(help="CSV laser,u,v,height_mm of points for --method thesis; else they are found.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Page (.html) to write, also where the calibration is refused.")
    ] = None,
    json: Json = False,
) -> None:
    """Calibrate camera, travel, laser sheets and ToF mount together, and say how sure each is."""
    from twinline.cli.calibrate import CalibrateRequest, run_calibrate

    parts = frozenset(name.strip() for name in only.split(",") if name.strip())
    run_calibrate(CalibrateRequest(capture, output, parts, start, json, method, picks, report))


@app.command()
def simulate(
    output: Annotated[Path, typer.Option("-o", "--output", help="New capture folder.")],
    scene: Annotated[
        str,
        typer.Option(
            help="three-objects, five-pieces, relief, steps, sphere, board, bed, or a mesh file (STL, PLY, OBJ, GLB)."
        ),
    ] = "three-objects",
    seed: Annotated[int, typer.Option(help="Of the noise: equal seeds give equal pictures.")] = 1,
    pitch: Annotated[float, typer.Option(help="Travel between frames, mm.")] = 0.5,
    parts: Annotated[
        str, typer.Option(help="What to add for calibration: camera, motion, tof, separated by commas.")
    ] = "",
) -> None:
    """Render a capture folder of a scene with the simulated scanner, its truth beside it."""
    from twinline.cli.simulate import run_simulate

    run_simulate(output, scene, seed, pitch, parts)


@app.command()
def scan(
    output: Annotated[Path, typer.Option("-o", "--output", help="Cloud to write: .ply or .glb.")],
    scene: Annotated[
        str, typer.Option(help="What lies on the simulated bed: a built-in scene or a mesh file.")
    ] = "three-objects",
    board: Annotated[
        str | None, typer.Option(help="Serial port of a real board, such as /dev/ttyACM0; simulated if absent.")
    ] = None,
    camera: Annotated[
        str | None, typer.Option(help="uvc:0, rtsp://, http://, a video or a folder; simulated if absent.")
    ] = None,
    machine: Annotated[Path | None, typer.Option(help="capture.json that describes a real scanner.")] = None,
    rig: Annotated[Path | None, typer.Option(help="Calibrated rig; a simulated machine brings its own.")] = None,
    area: Annotated[
        tuple[float, float] | None, typer.Option(help="Cart positions where the laser pass begins and ends, mm.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Speed of the laser pass, mm/s.")] = 12.5,
    alternating: Annotated[bool, typer.Option("--alternating", help="Let the lasers take turns.")] = False,
    tof: Annotated[bool, typer.Option(help="Make a ToF pass too.")] = True,
    tof_area: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(help="Cart from, to, slide from, to of the ToF pass, mm; a real machine makes none without it."),
    ] = None,
    tof_advance: Annotated[float, typer.Option(help="Distance of the ToF pass's rows, mm.")] = 3.0,
    tof_speed: Annotated[float, typer.Option(help="Speed of the ToF pass's sweeps, mm/s.")] = 20.0,
    rate: Annotated[float, typer.Option(help="Frames per second of the simulated camera.")] = 25.0,
    seed: Annotated[int, typer.Option(help="Of the simulated machine's noise.")] = 1,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="Let the simulated machine take the time that a real one takes.")
    ] = False,
    recording: Annotated[
        Path | None, typer.Option(help="New folder for the recording; else OUTPUT's name with .scan.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the scan in that folder, where it was interrupted.")
    ] = False,
    json: Json = False,
) -> None:
    """Make a whole scan: laser pass, ToF pass, cloud. Without --board and --camera on the simulated machine."""
    from twinline.cli.scan import ScanOptions, run_scan_command

    run_scan_command(
        ScanOptions(
            output, board, camera, machine, rig, scene, seed, area, speed, rate, alternating, tof, tof_area,
            tof_advance, tof_speed, real_time, recording, resume, json,
        )
    )  # fmt: skip


@app.command()
def doctor(
    board: Annotated[str | None, typer.Option(help="Also ask the board at this serial port.")] = None,
    camera: Annotated[str | None, typer.Option(help="Also ask the camera at this address.")] = None,
    json: Json = False,
) -> None:
    """Look whether this computer, the board and the camera are fit for scanning."""
    from twinline.cli.doctor import run_doctor

    run_doctor(board, camera, json=json)


@app.command()
def rig(
    capture: Annotated[Path, typer.Argument(help="Capture folder or recording.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="rig.json to write.")],
) -> None:
    """Write the nominal rig that a capture folder describes, as a start for a rig of your own."""
    from twinline.recording.capture import open_capture
    from twinline.recording.rig_file import write_rig

    write_rig(output, open_capture(capture).rig())


@app.command()
def board(
    output: Annotated[Path, typer.Option("-o", "--output", help="PDF to write.")],
    kind: Annotated[str, typer.Option(help="chessboard, charuco, circles or asymmetric-circles.")] = "charuco",
    columns: Annotated[int, typer.Option(help="Inner corners (circles) in a row.")] = 9,
    rows: Annotated[int, typer.Option(help="Rows of inner corners (circles).")] = 6,
    square: Annotated[float, typer.Option(help="Side of a square, or distance of circles, mm.")] = 18.0,
    marker: Annotated[float | None, typer.Option(help="Side of a ChArUco marker, mm; 0.75 squares if absent.")] = None,
    dictionary: Annotated[str, typer.Option(help="ChArUco marker dictionary.")] = "DICT_5X5_100",
    paper: Annotated[str, typer.Option(help="A4, A3, A2, A1, letter or tabloid.")] = "A4",
) -> None:
    """Write a calibration board as a PDF to print at 100 %, with a bar to measure."""
    from twinline.cli.board import BoardRequest, run_board

    run_board(BoardRequest(output, kind, columns, rows, square, marker, dictionary, paper))


@app.command("import")
def import_(
    folder: Annotated[Path, typer.Argument(help="Capture folder; or a recording that was cut off, to repair a copy.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Recording to write, such as scan.mcap.")],
    json: Json = False,
) -> None:
    """Put a capture folder into one recording; every picture stays as it is, byte by byte."""
    from twinline.cli.transfer import run_import

    run_import(folder, output, json=json)


@app.command()
def export(
    recording: Annotated[Path, typer.Argument(help="Recording, or the folder with the recordings of a scan.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="New capture folder.")],
    json: Json = False,
) -> None:
    """Turn a recording into a capture folder of ordinary files."""
    from twinline.cli.transfer import run_export

    run_export(recording, output, json=json)


@app.command()
def inspect(
    scan: Annotated[Path, typer.Argument(help="Cloud or mesh: PLY, STL, OBJ, GLB, OFF, or text of x y z.")],
    reference: Annotated[Path | None, typer.Argument(help="Mesh or cloud to compare it with.")] = None,
    measure: Annotated[
        list[str] | None,
        typer.Option(
            "-m", "--measure", help="plane, sphere, cylinder, prism, step, volume or distance:I,J; several times."
        ),
    ] = None,
    region: Annotated[
        list[str] | None, typer.Option(help="xmin,xmax,ymin,ymax[,zmin,zmax] in mm; twice for a step or two spheres.")
    ] = None,
    align: Annotated[str, typer.Option(help="search (from anywhere), near (from where they lie) or none.")] = "search",
    unit: Annotated[
        str, typer.Option(help="Of the reference where its format says none: auto, mm, inch or m.")
    ] = "auto",
    tolerance: Annotated[str, typer.Option(help="0.1 for ± 0.1 mm, or low,high in mm.")] = "",
    reach: Annotated[float | None, typer.Option(help="Points further from the reference are not compared, mm.")] = None,
    bed: Annotated[float | None, typer.Option(help="Leave out the scan's points below this height, mm.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Deviations as colours: .ply or .glb.")] = None,
    indices: Annotated[bool, typer.Option("--indices", help="With --json: the rows of the points used.")] = False,
    json: Json = False,
) -> None:
    """Measure a cloud or a mesh with uncertainties, or compare it with a reference mesh or another cloud."""
    from twinline.cli.inspect import InspectRequest, run_inspect

    run_inspect(
        InspectRequest(
            scan, reference, tuple(measure or ()), tuple(region or ()), align, unit, tolerance, reach, bed, output,
            indices, json,
        )
    )  # fmt: skip


@app.command()
def bench(
    json: Json = False,
    write: Annotated[Path | None, typer.Option(help="File whose tables to replace, such as PERFORMANCE.md.")] = None,
) -> None:
    """Measure speed and memory against reading the same bytes once and against the usual alternatives."""
    from twinline.cli.bench import run_bench

    run_bench(json=json, write=write)


def main() -> None:
    """Run the command line; exit status 0 only if the result is whole, errors in one sentence on stderr."""
    # OpenCV and FFmpeg would add their own words to it, of which none name the file.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    try:
        app(prog_name="twinline")
    except CancelledError:
        sys.exit(130)
    except TwinlineError as error:
        typer.echo(f"twinline: {error.detail}", err=True)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)
