"""How time and memory grow with the length of a scan."""

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import Executor, Future
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from twinline.bench.captures import bench_rig, write_capture
from twinline.bench.figures import Figure, Quartiles, Ratio, Section
from twinline.bench.turns import compare, take_turns
from twinline.errors import WorkerError
from twinline.reconstruction.offline import reconstruct
from twinline.recording.capture import open_capture

TIME_MUST = 1.10
MEMORY_MUST = 1.20
_DRAWN = 16
_SAMPLE_S = 0.01
_BYTES_PER_MB = 1e6
_PROC = Path("/proc")


class InlineExecutor(Executor):
    """Runs what it is given at once, in the calling thread: one core, and nothing that starts up."""

    def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]
        """The result of the call, as a finished future."""
        future: Future[object] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def time_per_frame(rounds: int, size: tuple[int, int], counts: tuple[int, ...], folder: Path) -> Section:
    """A whole reconstruction of passes of several lengths, per frame."""
    rig = bench_rig(size)
    captures = {_frames(n): write_capture(folder / str(n), size, n, drawn=_DRAWN, colour=False) for n in counts}

    def subject(name: str) -> Callable[[int], object]:
        return lambda _: reconstruct(captures[name], rig, executor=InlineExecutor())

    times = take_turns({name: subject(name) for name in captures}, rounds)
    for name, count in zip(captures, counts, strict=True):
        times[name] /= count
    first, last = _frames(counts[0]), _frames(counts[-1])
    figures = [
        Figure(
            name,
            Quartiles.of(times[name]),
            "us",
            () if name == first else (compare(times, name, first, must=TIME_MUST if name == last else None),),
        )
        for name in captures
    ]
    return Section(
        "time-per-frame",
        "Time per frame against the length of the scan",
        f"Whole reconstructions of gray frames of {size[0]} x {size[1]} px in one process, divided by their number of "
        "frames. What is settled once per scan makes short scans dearer; growing faster than the scan would show as a "
        "ratio above 1.",
        rounds,
        tuple(figures),
    )


def memory(size: tuple[int, int], counts: tuple[int, int], folder: Path) -> Section | None:
    """Peak memory of a reconstruction in processes of its own, the points apart; None where /proc does not tell."""
    if not _PROC.joinpath("self", "status").is_file():
        return None
    figures: list[Figure] = []
    rest: list[float] = []
    for n in counts:
        write_capture(folder / str(n), size, n, drawn=_DRAWN, colour=False)
        peak, points = _peak(folder / str(n), size)
        rest.append(peak - points)
        figures.append(Figure(f"peak, {_frames(n)}", _single(peak), "MB"))
        figures.append(Figure(f"points, {_frames(n)}", _single(points), "MB"))
        ratios = (Ratio(figures[2].name, _single(rest[-1] / rest[0]), MEMORY_MUST),) if len(rest) > 1 else ()
        figures.append(Figure(f"peak less points, {_frames(n)}", _single(rest[-1]), "MB", ratios))
    return Section(
        "memory",
        "Peak memory against the length of the scan",
        f"Resident memory of the process tree of one reconstruction (a parent and its workers), sampled every "
        f"{1000 * _SAMPLE_S:.0f} ms, gray frames of {size[0]} x {size[1]} px. The points are the bytes of the "
        "resulting cloud, once.",
        1,
        tuple(figures),
    )


def _frames(count: int) -> str:
    return f"{count} frames"


def _single(value: float) -> Quartiles:
    return Quartiles.of(np.array([value]))


def _peak(folder: Path, size: tuple[int, int]) -> tuple[float, float]:
    """Peak memory of reconstructing a capture, and the bytes of its points, in MB."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_reconstruct_in_child, args=(folder, size, theirs))
    process.start()
    theirs.close()
    highest = 0
    while not ours.poll(_SAMPLE_S):
        highest = max(highest, _tree_bytes(process.pid or 0))
    try:
        points = int(ours.recv())
    except EOFError:
        process.join()
        raise WorkerError(
            f"The reconstruction of {folder} that was measured ended with status {process.exitcode} and without a "
            "result: run twinline reconstruct to see why."
        ) from None
    process.join()
    return highest / _BYTES_PER_MB, points / _BYTES_PER_MB


def _reconstruct_in_child(folder: Path, size: tuple[int, int], connection: Connection) -> None:
    cloud = reconstruct(open_capture(folder), bench_rig(size)).cloud
    parts = (cloud.points_mm, cloud.sigma_mm, cloud.intensity, cloud.colour, cloud.source)
    connection.send(sum(part.nbytes for part in parts))


def _tree_bytes(root: int) -> int:
    """Resident memory of a process and all that descend from it."""
    parents, resident = {}, {}
    for folder in _PROC.glob("[0-9]*"):
        try:
            # The name, in brackets, may hold anything.
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        parents[int(folder.name)], resident[int(folder.name)] = int(fields[1]), int(fields[21])
    total = 0
    for pid, pages in resident.items():
        ancestor = pid
        while ancestor != root and ancestor in parents:
            ancestor = parents[ancestor]
        total += pages if ancestor == root else 0
    return total * os.sysconf("SC_PAGE_SIZE")
