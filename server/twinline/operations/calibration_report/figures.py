"""The pictures of a calibration report."""

import base64
import math

import cv2
import numpy as np

from twinline.arrays import ByteArray, FloatArray
from twinline.operations.calibration_report.drawings import Axis, Plot, axis_over, drawing
from twinline.operations.calibration_report.markup import length, number, sentence
from twinline.operations.calibration_report.model import (
    Convergence,
    CoverageReport,
    GroupReport,
    HeightDifferences,
    Histogram,
    PairReport,
    ScanUnderRig,
)

_STOPS = np.array([-1.0, -0.5, -0.15, 0.0, 0.15, 0.5, 1.0])
_COLOURS = np.array(
    [(28, 78, 155), (111, 159, 208), (201, 220, 236), (241, 242, 239), (246, 223, 184), (221, 154, 60), (143, 82, 0)],
    dtype=np.float64,
)
"""From too low (blue) over equal (nearly white) to too high (brown); safe for all colour vision."""

SENSOR_CSS = {"laser 1": "laser1", "laser 2": "laser2", "ToF": "tof"}
_MOST_MAP_PIXELS = 640
_NAME_STEP = 0.25


def residual_histogram(group: GroupReport) -> str:
    """All residuals as bars, those given up on top of them, held-out ones as an outline."""
    every, total = group.residuals, max(group.residuals.total, 1)
    held = group.held_out
    peak = max([*every.counts, 1]) / total
    if held is not None and held.total:
        peak = max(peak, max(held.counts) / held.total)
    reach = -every.low
    plot = Plot(
        Axis(-reach, reach, "residual, mm"),
        Axis(0.0, 105.0 * peak, "share, %"),
        f"Histogram of the residuals of {group.figures.kind}: {group.figures.observations} groups, root mean square "
        f"{group.figures.rms_mm:.3f} mm",
        width=300,
        height=170,
    )
    for i, count in enumerate(every.counts):
        low = every.low + i * every.width
        plot.bar(low, low + every.width, 100.0 * count / total, "bar")
        plot.bar(low, low + every.width, 100.0 * group.rejected.counts[i] / total, "bar gone")
    if held is not None and held.total:
        plot.line(*_outline(held, 100.0 / held.total), "line held")
    plot.upright(0.0, "zero")
    return plot.svg()


def _outline(histogram: Histogram, factor: float) -> tuple[list[float], list[float]]:
    xs, ys = [histogram.low], [0.0]
    for i, count in enumerate(histogram.counts):
        low = histogram.low + i * histogram.width
        xs += [low, low + histogram.width]
        ys += [factor * count] * 2
    return [*xs, xs[-1]], [*ys, 0.0]


def difference_histogram(pair: PairReport) -> str:
    """How the differences of two sensors spread on objects, what lies beyond the ends included in words."""
    found = pair.histogram
    total = max(found.total, 1)
    beyond = (found.below + found.above) / total
    plot = Plot(
        Axis(found.low, -found.low, "difference on objects, mm"),
        Axis(0.0, 105.0 * max([*found.counts, 1]) / total, "share, %"),
        f"Histogram of {pair.figures.pair} on objects: median {pair.figures.median_mm:.3f} mm, typical size "
        f"{pair.figures.typical_mm:.3f} mm, {100 * beyond:.0f} % beyond the ends",
        width=300,
        height=120,
    )
    for i, count in enumerate(found.counts):
        low = found.low + i * found.width
        plot.bar(low, low + found.width, 100.0 * count / total, "bar")
    plot.upright(0.0, "zero")
    if beyond > 0.005:
        plot.note(-found.low, plot.y.high, f"{100 * beyond:.0f} % beyond the ends", "remark", above=2.0)
    return plot.svg()


def difference_map(differences: HeightDifferences, label: str) -> str:
    """Differences over the bed, the longer side to the right; hatched where not both sensors saw the place."""
    values = np.array([[math.nan if v is None else v for v in row] for row in differences.rows_mm], dtype=np.float64)
    (low_x, low_y), size = differences.low_mm, differences.size_mm
    # Rows go along y. Lying on its side, a map of a wide bed leaves room for another one beside it.
    name, low, other = ("y", low_y, "x") if len(values) > values.shape[1] else ("x", low_x, "y")
    picture = values.T if name == "y" else values[::-1]
    rows, columns = picture.shape
    image = _png(picture / differences.reach_mm)
    width, height = 300.0, 300.0 * rows / columns
    content = (
        f'<rect class="unseen" width="{width}" height="{height:.1f}"/>'
        f'<image href="{image}" width="{width}" height="{height:.1f}" preserveAspectRatio="none"/>'
        f'<text class="tick" x="0" y="{height + 13:.1f}">{name} {number(low, 0)} mm</text>'
        f'<text class="tick" x="{width / 2}" y="{height + 13:.1f}" text-anchor="middle">'
        f"{other} {'downwards' if name == 'y' else 'upwards'}, {number(rows * size, 0)} mm</text>"
        f'<text class="tick" x="{width}" y="{height + 13:.1f}" text-anchor="end">'
        f"{number(low + columns * size, 0)} mm</text>"
    )
    return drawing(width, height + 18, label, content, css="map")


def _png(values: FloatArray) -> str:
    """Values from -1 to 1 as a data address of a picture; transparent where they are NaN."""
    clipped = np.clip(np.nan_to_num(values), -1.0, 1.0)
    channels = [np.interp(clipped, _STOPS, _COLOURS[:, i]) for i in (2, 1, 0)]
    picture = np.stack([*channels, np.where(np.isnan(values), 0.0, 255.0)], axis=-1)
    pixels: ByteArray = np.ascontiguousarray(np.rint(picture), dtype=np.uint8)
    # Some readers smooth a picture that they enlarge; then its cells must be large already.
    factor = max(1, _MOST_MAP_PIXELS // max(pixels.shape[:2]))
    pixels = np.repeat(np.repeat(pixels, factor, axis=0), factor, axis=1)
    _, encoded = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return "data:image/png;base64," + base64.b64encode(encoded.tobytes()).decode("ascii")


def colour_scale(reach_mm: float) -> str:
    """What the colours of the maps mean."""
    gradient = ", ".join(
        f"rgb({r:.0f} {g:.0f} {b:.0f}) {50 * (s + 1):.1f}%" for s, (r, g, b) in zip(_STOPS, _COLOURS, strict=True)
    )
    return (
        f'<p class="scale"><span>−{length(reach_mm)}</span><span class="ramp" style="background:linear-gradient('
        f'90deg, {gradient})"></span><span>+{length(reach_mm)} mm</span><span class="swatch unseen-swatch"></span>'
        "<span>not seen by both</span></p>"
    )


def profile_plot(scan: ScanUnderRig, title: str) -> str:
    """Heights of all sensors on one line along the travel."""
    xs = [x for p in scan.profiles for x in p.x_mm]
    zs = [z for p in scan.profiles for z in p.height_mm]
    plot = Plot(
        axis_over(xs, "along the travel, mm"),
        axis_over(_without_strays(zs), "height, mm"),
        f"Profile along the travel, {title}: heights by {', '.join(p.sensor for p in scan.profiles)}",
        width=320,
        height=200,
    )
    for p in scan.profiles:
        plot.dots(p.x_mm, p.height_mm, SENSOR_CSS.get(p.sensor, "other"), 1.3)
    return plot.svg()


def _without_strays(values: list[float]) -> list[float]:
    if not values:
        return []
    low, high = np.percentile(values, [0.5, 99.5])
    return [float(low), float(high)]


def convergence_plot(runs: list[tuple[str, str, Convergence]], series: str, label: str, *, log: bool) -> str:
    """One quantity of some Nelder-Mead runs by iteration: "value", "simplex", or a parameter's name.

    Parameters
    ----------
    runs
        Name in the drawing, style class, run.
    """
    lines = [(name, css, _series(run, series)) for name, css, run in runs]
    longest = max(len(values) for _, _, values in lines)
    plot = Plot(
        Axis(0.0, max(longest - 1.0, 1.0) * 1.02, "iteration"),
        axis_over([v for _, _, values in lines for v in values], label, log=log),
        f"{sentence(label)} by iteration: "
        + "; ".join(f"{name} ends at {values[-1]:.5g} after {len(values) - 1}" for name, _, values in lines),
        width=320,
        height=190,
    )
    for i, ((name, css, values), (_, _, run)) in enumerate(zip(lines, runs, strict=True)):
        plot.line(range(len(values)), values, f"line {css}")
        if len(lines) > 1:
            # Side by side, since lines that end at one height would lay their names over each other.
            place = int((1.0 - _NAME_STEP * i) * (len(values) - 1))
            plot.note(place, values[place], name, f"remark {css}")
        for restart in run.restarts:
            plot.upright(restart, f"restart {css}")
    return plot.svg()


def _series(run: Convergence, series: str) -> tuple[float, ...]:
    if series == "value":
        return run.values
    return run.simplex_size if series == "simplex" else run.parameters[series]


def corner_picture(coverage: CoverageReport) -> str:
    """Where in the image the points of the board were seen: used views as dots, others as crosses."""
    width, height = coverage.image_size
    scale = 360.0 / width
    used, unused = [], []
    for view in coverage.views:
        for u, v in view.corners_px:
            x, y = (u + 0.5) * scale, (v + 0.5) * scale
            if view.used:
                used.append(f"M{x:.1f} {y:.1f}h0")
            else:
                unused.append(f"M{x - 1.5:.1f} {y - 1.5:.1f}l3 3m-3 0l3 -3")
    tall = height * scale
    content = f'<rect class="frame" width="360" height="{tall:.1f}"/>'
    content += "".join(
        f'<line class="grid" x1="{360 * i / 3:.0f}" x2="{360 * i / 3:.0f}" y1="0" y2="{tall:.1f}"/>'
        f'<line class="grid" y1="{tall * i / 3:.1f}" y2="{tall * i / 3:.1f}" x1="0" x2="360"/>'
        for i in (1, 2)
    )
    content += f'<path class="crosses" d="{"".join(unused)}"/><path class="dots corner" d="{"".join(used)}"/>'
    label = f"Corners of the board in the image of {width} x {height} px: {len(used)} used, {len(unused)} not used"
    return drawing(360, tall, label, content)


def tilt_picture(coverage: CoverageReport) -> str:
    """How each view's board was tilted, and to which side; on one line where the side is not known."""
    known = [v for v in coverage.views if math.isfinite(v.tilt_deg)]
    if not any(math.isfinite(v.direction_deg) for v in known):
        return _tilt_line(coverage)
    size, middle = 230.0, 115.0
    scale = 105.0 / 60.0
    content = "".join(
        f'<circle class="grid" cx="{middle}" cy="{middle}" r="{scale * ring:.1f}"/>'
        f'<text class="tick" x="{middle + 3}" y="{middle - scale * ring - 2:.1f}">{ring}°</text>'
        for ring in (15, 30, 45)
    )
    content += f'<path class="grid" d="M{middle} 8V222M8 {middle}H222"/>'
    for view in known:
        if math.isfinite(view.direction_deg):
            turn, reach = math.radians(view.direction_deg), scale * min(view.tilt_deg, 60.0)
            x, y = middle + reach * math.cos(turn), middle + reach * math.sin(turn)
            css = "used" if view.used else "unused"
            content += f'<circle class="view {css}" cx="{x:.1f}" cy="{y:.1f}" r="4"/>'
    tilts = ", ".join(f"{v.tilt_deg:.0f}" for v in known)
    return drawing(size, size, f"Tilts of the board by side; in degrees {tilts}", content, css="square")


def _tilt_line(coverage: CoverageReport) -> str:
    tilts = [v.tilt_deg for v in coverage.views if math.isfinite(v.tilt_deg)]
    plot = Plot(
        Axis(0.0, 60.0, "tilt of the board, degrees"),
        Axis(0.0, 1.0, ""),
        "Tilts of the board, in degrees: " + (", ".join(f"{t:.0f}" for t in tilts) or "none known"),
        width=360,
        height=110,
    )
    plot.parts.append(_wanted(plot))
    plot.dots(tilts, [0.5] * len(tilts), "corner", 4.0)
    return drawing(plot.width, plot.height, plot.label, _line_frame(plot) + "".join(plot.parts))


def _wanted(plot: Plot) -> str:
    (x0, y0), (x1, y1) = plot.place(20.0, 0.0), plot.place(45.0, 1.0)
    return (
        f'<rect class="wanted" x="{x0:.1f}" y="{y1:.1f}" width="{x1 - x0:.1f}" height="{y0 - y1:.1f}"/>'
        f'<text class="remark" x="{(x0 + x1) / 2:.1f}" y="{y1 + 12:.1f}" text-anchor="middle">wanted</text>'
    )


def _line_frame(plot: Plot) -> str:
    found = ""
    for value, words in plot.x.ticks():
        x, y = plot.place(value, 0.0)
        found += f'<text class="tick" x="{x:.1f}" y="{y + 15:.1f}" text-anchor="middle">{words}</text>'
    (left, bottom), (right, _) = plot.place(0.0, 0.0), plot.place(60.0, 0.0)
    found += f'<line class="edge" x1="{left:.1f}" x2="{right:.1f}" y1="{bottom:.1f}" y2="{bottom:.1f}"/>'
    middle = (left + right) / 2
    return (
        found + f'<text class="axis" x="{middle:.1f}" y="{plot.height - 4}" text-anchor="middle">{plot.x.label}</text>'
    )
