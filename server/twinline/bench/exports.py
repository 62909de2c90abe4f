"""Writing a large cloud, against writing as many bytes."""

import os
from pathlib import Path

import numpy as np

from twinline import __version__
from twinline.bench.figures import Figure, Quartiles, Section
from twinline.bench.turns import compare, take_turns
from twinline.fusion.cloud import PointCloud, Source
from twinline.operations.exports.glb import write_glb
from twinline.operations.exports.ply import write_ply
from twinline.operations.exports.provenance import Provenance

_SEED = 20240603
_US_PER_MS = 1e3


def write_clouds(rounds: int, points: int, folder: Path) -> Section:
    """PLY and GLB of a cloud, each whole, flushed to the disk and renamed."""
    rng = np.random.default_rng(_SEED)
    cloud = PointCloud(
        rng.uniform(-100, 100, (points, 3)).astype(np.float32),
        rng.uniform(0.02, 0.2, points).astype(np.float32),
        rng.uniform(20, 250, points).astype(np.float32),
        rng.integers(0, 256, (points, 3), dtype=np.uint8),
        rng.choice(np.array([Source.LASER_1, Source.LASER_2], np.uint8), points),
    )
    provenance = Provenance("bench", "bench", __version__)
    folder.mkdir(parents=True)
    paths = {kind: folder / f"cloud.{kind}" for kind in ("ply", "glb")}
    write_ply(paths["ply"], cloud, provenance)
    write_glb(paths["glb"], cloud, provenance)
    bytes_of = {kind: path.read_bytes() for kind, path in paths.items()}
    times = take_turns(
        {
            _plain("PLY"): lambda _: _write(folder / "plain", bytes_of["ply"]),
            "PLY": lambda _: write_ply(paths["ply"], cloud, provenance),
            _plain("GLB"): lambda _: _write(folder / "plain", bytes_of["glb"]),
            "GLB": lambda _: write_glb(paths["glb"], cloud, provenance),
        },
        rounds,
        waiting=True,
    )
    for name in times:
        times[name] /= _US_PER_MS
    figures = []
    for kind in ("PLY", "GLB"):
        figures.append(Figure(_plain(kind), Quartiles.of(times[_plain(kind)]), "ms"))
        figures.append(Figure(kind, Quartiles.of(times[kind]), "ms", (compare(times, kind, _plain(kind)),)))
    return Section(
        "exports",
        f"Writing {points} points",
        "Binary PLY and GLB; the plain bytes are those of the finished file, written and flushed in one go.",
        rounds,
        tuple(figures),
    )


def _plain(kind: str) -> str:
    return f"plain bytes of the {kind}"


def _write(path: Path, data: bytes) -> None:
    with path.open("wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())
