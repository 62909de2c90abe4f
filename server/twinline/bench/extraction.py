"""Stripe extraction against reading every byte of the frame once, and against the usual ways."""

from collections.abc import Callable, Iterator

import cv2
import numpy as np
from scipy.optimize import curve_fit

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.bench.figures import Figure, Quartiles, Ratio, Section
from twinline.bench.machine import private_cache_bytes
from twinline.bench.passes import HIGHEST, NARROW_SUM, PASSES, PLAIN_SUM, highest
from twinline.bench.pictures import NOISE_DN, Brush
from twinline.bench.turns import Subject, compare, take_turns
from twinline.geometry.noise import NoiseModel
from twinline.stripe.extraction import extract_light
from twinline.stripe.light import take_light
from twinline.stripe.model import Channel, ExtractionSettings

EXTRACTION = "two stripes with all flags"
DIFFERENCE = "two stripes, red less blue"
GRAY_MUST, GRAY_AIM = 10.0, 4.0
BGR_MUST, BGR_AIM = 4.0, 2.0
_SEED = 20240601
_POOL_CACHES = 8
_DRAWN = 8
_NOISE = NoiseModel(read_dn=NOISE_DN)
_THRESHOLD_DN = 50
_FITTED_PX = 12
_FWHM = 2.355

Way = Callable[[ByteArray], object]


def gray_in_cache(rounds: int, size: tuple[int, int]) -> Section:
    """One gray frame again and again: it stays in the core's own cache."""
    brush = Brush(*size, np.random.default_rng(_SEED))
    frame = brush.gray(brush.waves())
    ways: dict[str, Way] = {**_passes(), EXTRACTION: _extraction(brush.halves(), "gray")}
    times = take_turns(
        {n: _on(way, [frame], 0) for n, way in ways.items()}, rounds, before=lambda: highest(_flat(frame))
    )
    return Section(
        "gray-in-cache",
        "Gray frame, in cache",
        "One frame, read once, untimed, before every timed call, so that each finds it in the same caches.",
        rounds,
        _against_passes(times, (EXTRACTION,), GRAY_MUST, GRAY_AIM),
    )


def gray_from_memory(rounds: int, size: tuple[int, int]) -> Section:
    """Frames in turn out of a pool that no core's own cache holds, as they come from a camera."""
    brush = Brush(*size, np.random.default_rng(_SEED))
    pool = _pool([brush.gray(brush.waves(k / _DRAWN)) for k in range(_DRAWN)])
    ways: dict[str, Way] = {**_passes(), EXTRACTION: _extraction(brush.halves(), "gray")}
    times = take_turns(_spread(ways, pool), rounds)
    return Section(
        "gray-from-memory",
        "Gray frame, from memory",
        f"{len(pool)} frames in turn, {_POOL_CACHES} times the core's own cache or more, as they come from a camera.",
        rounds,
        _against_passes(times, (EXTRACTION,), GRAY_MUST, GRAY_AIM),
    )


def colour_in_place(rounds: int, size: tuple[int, int]) -> Section:
    """Frames of three interleaved channels, measured where they are."""
    brush = Brush(*size, np.random.default_rng(_SEED))
    pool = _pool([brush.colour(brush.waves(k / _DRAWN)) for k in range(_DRAWN)])
    bands = brush.halves()
    ways: dict[str, Way] = {
        **_passes(), EXTRACTION: _extraction(bands, "red"), DIFFERENCE: _extraction(bands, "red-blue")
    }  # fmt: skip
    times = take_turns(_spread(ways, pool), rounds)
    return Section(
        "colour-in-place",
        "Colour frame (BGR) in place, from memory",
        f"{len(pool)} frames in turn. The promise is for one channel; red less blue is what a textured bed takes.",
        rounds,
        _against_passes(times, (EXTRACTION, DIFFERENCE), BGR_MUST, BGR_AIM),
    )


def usual_ways(rounds: int, size: tuple[int, int], fitted_columns: int) -> Section:
    """The same two stripes by the usual ways, on one gray frame in cache."""
    brush = Brush(*size, np.random.default_rng(_SEED))
    frame = brush.gray(brush.waves())
    bands = brush.halves()
    ways: dict[str, Way] = {
        EXTRACTION: _extraction(bands, "gray"),
        "NumPy argmax of every column": lambda image: [np.argmax(half, axis=0) for half in _split(image)],
        "OpenCV blur, threshold, centroid": lambda image: [_centroids(half) for half in _split(image)],
    }
    times = take_turns({n: _on(way, [frame], 0) for n, way in ways.items()}, rounds)
    figures = [Figure(EXTRACTION, Quartiles.of(times[EXTRACTION]), "us")]
    figures += [
        Figure(n, Quartiles.of(times[n]), "us", (compare(times, n, EXTRACTION),)) for n in ways if n != EXTRACTION
    ]
    name = f"SciPy curve_fit of a Gaussian ({fitted_columns} columns, scaled to all)"
    columns = np.linspace(_FITTED_PX, size[0] - 1 - _FITTED_PX, fitted_columns).astype(np.int64)
    half = _split(frame)[0]
    few = take_turns(
        {EXTRACTION: _on(ways[EXTRACTION], [frame], 0), name: lambda _: _gaussians(half, columns)}, max(rounds // 10, 3)
    )
    few[name] *= 2 * size[0] / fitted_columns
    figures.append(Figure(name, Quartiles.of(few[name]), "us", (compare(few, name, EXTRACTION),)))
    return Section(
        "usual-ways",
        "The usual ways",
        "One gray frame, two stripes, each in its half of the picture; none of the others gives a deviation or a flag.",
        rounds,
        tuple(figures),
    )


def _passes() -> dict[str, Way]:
    def way(read: Callable[[ByteArray], int]) -> Way:
        return lambda image: read(_flat(image))

    return {name: way(read) for name, read in PASSES.items()}


def _flat(image: ByteArray) -> ByteArray:
    return image.reshape(image.size)


def _extraction(bands: IntArray, channel: Channel) -> Way:
    settings = ExtractionSettings(channel=channel, noise=_NOISE)
    return lambda image: extract_light(take_light(image, channel, along_v=False), bands, settings, _NOISE)


def _pool(drawn: list[ByteArray]) -> list[ByteArray]:
    """Copies of the drawn pictures, together far larger than the core's own cache."""
    count = max(-(-_POOL_CACHES * private_cache_bytes() // drawn[0].nbytes), 2 * len(drawn))
    return [drawn[k % len(drawn)].copy() for k in range(count)]


def _spread(ways: dict[str, Way], pool: list[ByteArray]) -> dict[str, Subject]:
    """Each way goes through the whole pool, from a place of its own, so that none finds what another has just read."""
    return {name: _on(way, pool, k * len(pool) // len(ways)) for k, (name, way) in enumerate(ways.items())}


def _on(way: Way, pool: list[ByteArray], start: int) -> Subject:
    return lambda number: way(pool[(start + number) % len(pool)])


def _against_passes(
    times: dict[str, FloatArray], extractions: tuple[str, ...], must: float, aim: float
) -> tuple[Figure, ...]:
    def lines() -> Iterator[Figure]:
        for name in PASSES:
            yield Figure(name, Quartiles.of(times[name]), "us")
        for name in extractions:
            promised = name == EXTRACTION
            ratios: list[Ratio] = [
                compare(times, name, PLAIN_SUM, must=must, aim=aim) if promised else compare(times, name, PLAIN_SUM)
            ]
            ratios += [compare(times, name, other) for other in (NARROW_SUM, HIGHEST)]
            yield Figure(name, Quartiles.of(times[name]), "us", tuple(ratios))

    return tuple(lines())


def _split(image: ByteArray) -> tuple[ByteArray, ByteArray]:
    middle = image.shape[0] // 2
    return image[middle:], image[:middle]


def _centroids(image: ByteArray) -> FloatArray:
    """Centre of gravity of every column of what is bright, after a blur."""
    blurred = cv2.GaussianBlur(image, (5, 5), 0)
    _, bright = cv2.threshold(blurred, _THRESHOLD_DN, 255, cv2.THRESH_TOZERO)
    mass = cv2.reduce(bright, 0, cv2.REDUCE_SUM, dtype=cv2.CV_32F)[0]
    moment = np.arange(len(bright), dtype=np.float32) @ bright.astype(np.float32)
    return np.asarray(moment / np.maximum(mass, 1.0))


def _gaussians(image: ByteArray, columns: IntArray) -> list[FloatArray]:
    """Least-squares Gaussians around the brightest pixels of some columns."""
    fits: list[FloatArray] = []
    for column in columns:
        peak = int(np.clip(np.argmax(image[:, column]), _FITTED_PX, len(image) - 1 - _FITTED_PX))
        rows = np.arange(peak - _FITTED_PX, peak + _FITTED_PX + 1, dtype=np.float64)
        levels = image[peak - _FITTED_PX : peak + _FITTED_PX + 1, column].astype(np.float64)
        start = (levels.max() - levels.min(), peak, _FITTED_PX / _FWHM / 2, levels.min())
        fits.append(np.asarray(curve_fit(_gaussian, rows, levels, p0=start)[0]))
    return fits


def _gaussian(x: FloatArray, a: float, mu: float, s: float, b: float) -> FloatArray:
    return np.asarray(b + a * np.exp(-0.5 * ((x - mu) / s) ** 2))
