"""``twinline stripes``."""

import csv
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import typer

from twinline.arrays import ByteArray
from twinline.cli.progress import progress
from twinline.errors import CaptureError, FrameError, InputError, OutputError, StripeError
from twinline.geometry.noise import NoiseModel
from twinline.geometry.rig import StripeRuns
from twinline.operations.exports.atomic import atomic_path
from twinline.recording.capture import open_capture
from twinline.recording.container_walk import is_container
from twinline.recording.images import PictureFile, read_image
from twinline.stripe import extract
from twinline.stripe.layout import Layout, find_layout
from twinline.stripe.model import Channel, ExtractionSettings, Flag, Method, StripeProfile

COLUMNS = ("image", "laser", "u", "v", "sd_px", "amplitude", "width_px", "flags")
_COLOURS = ((0, 255, 0), (255, 255, 0))


@dataclass(frozen=True)
class StripesRequest:
    """The options of the command."""

    images: tuple[Path, ...]
    output: Path
    method: str
    channel: str
    runs: str
    lasers: str
    off: Path | None
    noise: str | None
    overlay: Path | None
    json: bool

    def settings(self) -> ExtractionSettings:
        """As the extraction takes them; refuses what it does not know."""
        if self.runs not in ("auto", "along-u", "along-v"):
            raise InputError(f"--runs {self.runs}: choose along-u, along-v or auto.")
        if self.lasers not in ("auto", "1", "2"):
            raise InputError(f"--lasers {self.lasers}: choose 1, 2 or auto.")
        return ExtractionSettings(cast(Method, self.method), cast(Channel, self.channel), _noise(self.noise))


def run_stripes(request: StripesRequest) -> None:
    """Extract the stripes of every picture into one CSV."""
    settings = request.settings()
    off = read_image(request.off) if request.off is not None else None
    if request.overlay is not None:
        _make_folder(request.overlay)
    summary = []
    with (
        atomic_path(request.output) as target,
        target.open("w", newline="", encoding="utf-8") as file,
        progress("Pictures", quiet=request.json) as report,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        pictures = [picture for path in request.images for picture in _pictures(path)]
        for number, path in enumerate(pictures):
            report(number, len(pictures))
            image = read_image(path)
            layout, profile = _extract(path, image, off, settings, request)
            writer.writerows(_rows(path, layout, profile))
            summary.append(_summary(path, layout, profile))
            if request.overlay is not None:
                _draw(request.overlay / f"{path.stem}.png", image, layout, profile)
        if not any(n for picture in summary for n in cast(list[int], picture["found"])):
            names = str(pictures[0]) if len(pictures) == 1 else f"any of the {len(pictures)} pictures"
            raise StripeError(f"No laser stripe in {names}: check the exposure, --runs, --channel and --off.")
    if request.json:
        typer.echo(json.dumps({"output": str(request.output), "images": summary}, indent=1))
    else:
        for picture in summary:
            counts = ", ".join(f"laser {i}: {n}" for i, n in enumerate(cast(list[int], picture["found"]), 1))
            typer.echo(f"{picture['image']}: {picture['runs']}, {counts} of {picture['columns']}")


def _pictures(path: Path) -> Sequence[PictureFile]:
    """The picture, or the frames of a recording's laser pass."""
    if not is_container(path):
        return [path]
    laser = open_capture(path).laser
    if laser is None:
        raise CaptureError(f"{path} holds no laser pass: give a recording with one, or pictures.")
    return [laser.picture(entry) for entry in laser.frames]


def _extract(
    path: PictureFile, image: ByteArray, off: ByteArray | None, settings: ExtractionSettings, request: StripesRequest
) -> tuple[Layout, StripeProfile]:
    try:
        runs = None if request.runs == "auto" else cast(StripeRuns, request.runs)
        lasers = None if request.lasers == "auto" else int(request.lasers)
        layout = find_layout(image, settings, off=off, runs=runs, lasers=lasers)
        settings = replace(settings, channel=layout.channel)
        return layout, extract(image, settings, runs=layout.runs, bands=layout.bands, off=off)
    except StripeError as error:
        raise FrameError(f"{path}: {error.detail}", code=error.code) from error


def _rows(path: PictureFile, layout: Layout, profile: StripeProfile) -> Iterator[tuple[object, ...]]:
    for k in range(len(profile.centre_px)):
        for column in np.flatnonzero(profile.found[k]):
            across = f"{profile.centre_px[k, column]:.4f}"
            u, v = (column, across) if layout.runs == "along-u" else (across, column)
            yield (
                str(path), k + 1, u, v, f"{profile.sd_px[k, column]:.4f}", f"{profile.amplitude_dn[k, column]:.2f}",
                f"{profile.width_px[k, column]:.3f}", flag_names(int(profile.flags[k, column])),
            )  # fmt: skip


def flag_names(flags: int) -> str:
    """Names of flags, joined by a bar; empty if there are none."""
    return "|".join((f.name or "").lower().replace("_", "-") for f in Flag if flags & f)


def _summary(path: PictureFile, layout: Layout, profile: StripeProfile) -> dict[str, object]:
    found = profile.found.sum(axis=1).tolist()
    sds = [float(np.nanmedian(row)) if np.isfinite(row).any() else None for row in profile.sd_px]
    return {
        "image": str(path),
        "runs": layout.runs,
        "columns": profile.centre_px.shape[1],
        "found": found,
        "median_sd_px": sds,
    }


def _draw(target: Path, image: ByteArray, layout: Layout, profile: StripeProfile) -> None:
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    for k, colour in zip(range(len(profile.centre_px)), _COLOURS, strict=False):
        columns = np.flatnonzero(profile.found[k])
        across = np.rint(profile.centre_px[k, columns]).astype(int)
        v, u = (across, columns) if layout.runs == "along-u" else (columns, across)
        inside = (v >= 0) & (v < picture.shape[0]) & (u >= 0) & (u < picture.shape[1])
        picture[v[inside], u[inside]] = colour
    written, data = cv2.imencode(".png", picture)
    if not written:
        raise OutputError(f"{target}: the overlay could not be encoded.")
    with atomic_path(target) as path:
        path.write_bytes(data.tobytes())


def _noise(text: str | None) -> NoiseModel | None:
    if text is None:
        return None
    parts = text.split(",")
    try:
        n, k, c = (float(part) for part in parts)
    except ValueError:
        raise InputError(f"--noise {text}: give three numbers n,K,C such as 1.5,inf,0.2.") from None
    return NoiseModel(n, k, c)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder} cannot be made: {error.strerror or error}.") from error
