"""Plots as inline SVG: axes with round numbers, lines, points, bars. Colours come from the page's style by class."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from twinline.operations.calibration_report.markup import number, text

_LEFT, _RIGHT, _TOP, _BOTTOM = 58.0, 12.0, 12.0, 36.0
_TICKS = 5


@dataclass(frozen=True)
class Axis:
    """An interval with its name; on a logarithmic one both ends are positive."""

    low: float
    high: float
    label: str
    log: bool = False

    def share(self, value: float) -> float:
        """Place on the axis, 0 at its low end and 1 at its high one; values beyond stay at the ends."""
        if self.log:
            value, low, high = (math.log10(max(v, 1e-300)) for v in (value, self.low, self.high))
        else:
            low, high = self.low, self.high
        return min(max((value - low) / (high - low), -0.02), 1.02) if high > low else 0.5

    def ticks(self) -> list[tuple[float, str]]:
        """Round numbers within, each with its text."""
        if self.log:
            return self._decades()
        step = _round_step((self.high - self.low) / _TICKS)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        return [(i * step, number(i * step, decimals)) for i in range(first, last + 1)]

    def _decades(self) -> list[tuple[float, str]]:
        first, last = math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9)
        every = max(1, math.ceil((last - first) / _TICKS))
        powers = range(first, last + 1, every)
        return [(10.0**p, number(10.0**p, max(0, -p)) if -4 < p < 6 else f"1e{p}".replace("-", "−")) for p in powers]


def _round_step(rough: float) -> float:
    power = 10.0 ** math.floor(math.log10(max(rough, 1e-12)))
    return next(s * power for s in (1.0, 2.0, 5.0, 10.0) if s * power >= rough * (1 - 1e-9))


def axis_over(values: Iterable[float], label: str, *, log: bool = False) -> Axis:
    """An axis that holds all finite values, with a little room."""
    finite = [v for v in values if math.isfinite(v) and (v > 0 or not log)]
    low, high = (min(finite), max(finite)) if finite else (0.0, 1.0)
    if log:
        low, high = (low or 1e-6) / 1.3, high * 1.3
        if high / low < 20:
            low, high = low / 2, high * 2
        return Axis(low, high, label, log=True)
    room = 0.06 * (high - low) or 0.5 * abs(high) or 1.0
    return Axis(low - room, high + room, label)


@dataclass
class Plot:
    """A drawing that grows element by element.

    Parameters
    ----------
    label
        What a screen reader says in its place.
    """

    x: Axis
    y: Axis
    label: str
    width: float = 360.0
    height: float = 220.0
    parts: list[str] = field(default_factory=list)

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Of values, in the drawing's units."""
        return (
            _LEFT + self.x.share(x) * (self.width - _LEFT - _RIGHT),
            self.height - _BOTTOM - self.y.share(y) * (self.height - _TOP - _BOTTOM),
        )

    def line(self, xs: Sequence[float], ys: Sequence[float], css: str) -> None:
        """A line through points; one that is not finite interrupts it."""
        pieces: list[list[str]] = [[]]
        for x, y in zip(xs, ys, strict=True):
            if math.isfinite(x) and math.isfinite(y):
                px, py = self.place(x, y)
                pieces[-1].append(f"{px:.1f},{py:.1f}")
            elif pieces[-1]:
                pieces.append([])
        self.parts += [f'<polyline class="{css}" points="{" ".join(p)}"/>' for p in pieces if p]

    def dots(self, xs: Sequence[float], ys: Sequence[float], css: str, radius: float = 1.6) -> None:
        """Points, as one path."""
        d = []
        for x, y in zip(xs, ys, strict=True):
            px, py = self.place(x, y)
            d.append(f"M{px:.1f} {py:.1f}h0")
        if d:
            self.parts.append(f'<path class="dots {css}" style="stroke-width:{2 * radius:g}" d="{"".join(d)}"/>')

    def bar(self, low: float, high: float, height: float, css: str) -> None:
        """An upright bar from the bottom."""
        (x0, y0), (x1, y1) = self.place(low, self.y.low), self.place(high, height)
        if y0 - y1 > 0.05:
            self.parts.append(
                f'<rect class="{css}" x="{x0 + 0.5:.1f}" y="{y1:.1f}" width="{max(x1 - x0 - 1, 0.5):.1f}" '
                f'height="{y0 - y1:.1f}"/>'
            )

    def upright(self, x: float, css: str) -> None:
        """A line from bottom to top."""
        (x0, y0), (_, y1) = self.place(x, self.y.low), self.place(x, self.y.high)
        self.parts.append(f'<line class="{css}" x1="{x0:.1f}" x2="{x0:.1f}" y1="{y0:.1f}" y2="{y1:.1f}"/>')

    def note(self, x: float, y: float, words: str, css: str, *, anchor: str = "end", above: float = 6.0) -> None:
        """A few words beside a point."""
        px, py = self.place(x, y)
        self.parts.append(
            f'<text class="{css}" x="{px:.1f}" y="{py - above:.1f}" text-anchor="{anchor}">{text(words)}</text>'
        )

    def svg(self) -> str:
        """The drawing."""
        return drawing(self.width, self.height, self.label, self._frame() + "".join(self.parts))

    def _frame(self) -> str:
        found = []
        left, right, bottom = _LEFT, self.width - _RIGHT, self.height - _BOTTOM
        for value, words in self.y.ticks():
            _, y = self.place(self.x.low, value)
            found.append(f'<line class="grid" x1="{left}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>')
            found.append(f'<text class="tick" x="{left - 6}" y="{y + 3.5:.1f}" text-anchor="end">{words}</text>')
        for value, words in self.x.ticks():
            x, _ = self.place(value, self.y.low)
            found.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{bottom}" y2="{bottom + 4}"/>')
            found.append(f'<text class="tick" x="{x:.1f}" y="{bottom + 15}" text-anchor="middle">{words}</text>')
        middle = (left + right) / 2
        found.append(
            f'<text class="axis" x="{middle}" y="{self.height - 4}" text-anchor="middle">{text(self.x.label)}</text>'
        )
        height = (self.height - _BOTTOM + _TOP) / 2
        found.append(
            f'<text class="axis" transform="translate(11 {height}) rotate(-90)" text-anchor="middle">'
            f"{text(self.y.label)}</text>"
        )
        found.append(f'<line class="edge" x1="{left}" x2="{right}" y1="{bottom}" y2="{bottom}"/>')
        return "".join(found)


def drawing(width: float, height: float, label: str, content: str, *, css: str = "") -> str:
    """An SVG element that scales with its column and reads as ``label``."""
    return (
        f'<svg class="{css}" viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{text(label)}" '
        f'xmlns="http://www.w3.org/2000/svg">{content}</svg>'
    )
