"""Measures the whole grid of stripe centres and writes it into ACCURACY.md: ``python -m tests.accuracy.report_stripe``.

With ``--print`` the section goes to standard output and the file stays as it is.
"""

import sys
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from tests.accuracy import stripe_situations as situations
from tests.accuracy.report_section import write_section
from tests.accuracy.stripe_grids import (
    ADDITIVE,
    BUDGETED_CONTRASTS,
    COLUMNS,
    CONTRASTS,
    EXCESSES,
    FULL_SCALE_DN,
    GRADIENTS,
    SATURATED,
    SEED,
    SHOT,
    SLOPED,
    SPECKLED,
    WIDTHS,
    Outcome,
    given,
    plain,
    saturated,
)
from tests.accuracy.synthetic_columns import Stripe
from twinline.stripe import METHODS, Method

GROSS_MUST = 0.002

Cells = Sequence[Stripe]
Measure = Callable[[Stripe], Outcome]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def number(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:.0f}"


def percent(share: float) -> str:
    return f"{100 * share:.2f} %" if share else "0"


def grid(cells: Cells, measure: Measure, entry: Callable[[Outcome], str], down: Callable[[Stripe], str]) -> str:
    """One row per value of ``down``, one column per amplitude and noise."""
    across = list(dict.fromkeys((s.amplitude_dn, s.noise_dn) for s in cells))
    rows = list(dict.fromkeys(down(s) for s in cells))
    found = {(down(s), (s.amplitude_dn, s.noise_dn)): entry(measure(s)) for s in cells}
    head = ["", *(f"{a:g}/{n:g}" for a, n in across)]
    return table(head, ([row, *(found[row, key] for key in across)] for row in rows))


def both(outcome: Outcome) -> str:
    return f"{outcome.ratio:.2f} {outcome.sd_ratio:.2f}"


def by_width(stripe: Stripe) -> str:
    return f"{stripe.width_px:g} px"


def summary_row(name: str, cells: Cells, measure: Measure, must: float, aim: float) -> list[str]:
    found = [measure(s) for s in cells]
    ratios = np.array([o.ratio for o in found])
    sds = np.array([o.sd_ratio for o in found])
    return [
        name,
        str(len(found)),
        f"{must:.2f} / {aim:.2f}",
        f"{np.median(ratios):.3f}",
        f"{ratios.max():.3f}",
        f"{(ratios > must).sum()} / {(ratios > aim).sum()}",
        f"{sds.min():.2f}-{sds.max():.2f}",
        f"{(np.abs(sds - 1) > 0.2).sum()} / {(np.abs(sds - 1) > 0.1).sum()}",
        percent(max(o.lost for o in found)),
        percent(max(o.gross for o in found)),
        percent(max(o.astray for o in found)),
    ]


def coarse(contrast: float | None = None) -> Cells:
    return [s for s in SPECKLED if (s.contrast in BUDGETED_CONTRASTS if contrast is None else s.contrast == contrast)]


GOALS: tuple[tuple[str, Cells, Measure, float, float], ...] = (
    ("additive", ADDITIVE, plain, 1.10, 1.05),
    ("gradient to 2 DN/px", SLOPED, plain, 1.15, 1.08),
    ("saturated 2x to 10x", SATURATED, saturated, 1.20, 1.10),
    ("speckle, noise known", coarse(), given, 1.25, 1.15),
    ("speckle, noise from the picture", coarse(), plain, 1.25, 1.15),
    ("shot noise, noise known", SHOT, given, 1.10, 1.05),
)


def summary() -> str:
    head = ["grid", "cells", "must / aim", "median", "worst", "cells over must / aim"]
    head += ["reported sd / real", "sd off > 20 / 10 %", "most lost", "most gross", "most astray"]
    return table(head, (summary_row(*goal) for goal in GOALS))


def misses() -> str:
    """Every cell over its must column, in words."""
    lines = []
    for name, cells, measure, must, _ in GOALS:
        for outcome in map(measure, cells):
            wrong = []
            if outcome.ratio > must:
                wrong.append(f"error {outcome.ratio:.3f} of the bound")
            if abs(outcome.sd_ratio - 1) > 0.2:
                wrong.append(f"reported sd {outcome.sd_ratio:.2f} of the real one (pull {outcome.pull:.2f})")
            if max(outcome.gross, outcome.astray) > GROSS_MUST:
                wrong.append(f"{percent(outcome.gross)} gross")
            if wrong:
                lines.append(f"- {name}, {outcome.stripe}: {', '.join(wrong)}")
    return "\n".join(lines or ["- none"]) + "\n"


def astray_cells() -> str:
    """Cells with centres astray, and what the ratio is with them."""
    found = [(name, measure(s)) for name, cells, measure, _, _ in GOALS for s in cells]
    rows = [
        [name, str(o.stripe), percent(o.astray), number(o.ratio), number(o.ratio_of_all)]
        for name, o in found
        if o.astray
    ]
    return table(["grid", "cell", "astray", "ratio without", "ratio of all"], rows)


def methods() -> str:
    """All methods on the same pixels: median and worst ratio, and the largest share astray."""
    clear = [s for s in SPECKLED if s.contrast == 0.37 and s.amplitude_dn < 100]
    steep = [s for s in SLOPED if abs(s.gradient_dn_per_px) == max(GRADIENTS)]

    def entry(outcomes: list[Outcome]) -> str:
        ratios = [o.ratio for o in outcomes if np.isfinite(o.ratio)]
        text = f"{number(float(np.median(ratios)))} / {number(max(ratios))}"
        return text + (f" ({percent(bad)})" if (bad := max(o.astray for o in outcomes)) > GROSS_MUST else "")

    def row(method: Method) -> list[str]:
        locks = [situations.locking(s, method).worst_px for s in situations.LOCKED]
        return [
            method,
            entry([plain(s, method) for s in ADDITIVE]),
            entry([plain(s, method) for s in steep]),
            entry([plain(s, method) for s in clear]),
            entry([saturated(s, method) for s in SATURATED]),
            f"{max(locks):.4f} px",
        ]

    head = ["method", "additive", "gradient 2 DN/px", "speckle 0.37", "saturated", "pixel locking"]
    return table(head, (row(m) for m in METHODS))


def locking() -> str:
    found = [situations.locking(s) for s in situations.LOCKED]
    rows = [[by_width(x.stripe), f"{x.worst_px:.4f}", f"{x.rms_px:.4f}", f"{x.chance_px:.4f}"] for x in found]
    return table(["width", "largest, px", "RMS, px", "RMS by chance, px"], rows)


def detection() -> str:
    empty = [
        [f"no stripe, noise {n:g} DN, gradient {g:g} DN/px", "", percent(situations.false_share(n, g)), ""]
        for g in (0.0, 0.15)
        for n in (1.0, 2.0, 4.0, 6.0)
    ]
    rows = []
    for stripe in situations.GAPPED:
        found, false, gross = situations.gaps(stripe)
        rows.append([f"gaps, {stripe}", f"{100 * found:.2f} %", percent(false), percent(gross)])
    return table(["picture", "lit columns found", "dark columns found", "gross"], [*empty, *rows])


def border() -> str:
    rows = [
        [str(s), side, f"{x.ratio:.3f}", percent(x.lost), f"{100 * x.flagged:.1f} %"]
        for s in situations.LEAVING
        for side in ("top", "bottom")
        for x in [situations.leaving(s, side)]
    ]
    return table(["stripe", "side", "ratio", "lost", "flagged within 1.9 widths"], rows)


def texture() -> str:
    ways = (("red", False), ("red-blue", False), ("red", True), ("red-blue", True))

    def cell(outcome: Outcome) -> str:
        rms_px = outcome.ratio * outcome.bound_px
        gross = f", {percent(outcome.gross)} gross" if outcome.gross else ""
        return f"{rms_px:.3f} px, {number(outcome.ratio)}{gross}"

    rows = (
        [str(s), *(cell(situations.on_texture(s, "red" if c == "red" else "red-blue", off=off)) for c, off in ways)]
        for s in situations.TEXTURED
    )
    return table(["stripe", "red", "red less blue", "red less laser-off", "both"], rows)


def two_lasers() -> str:
    rows = [
        [str(s), *(f"{o.ratio_of_all:.3f}, lost {percent(o.lost)}" for o in situations.two_lasers(s))]
        for s in (Stripe(1.0, 80.0, 3.0), Stripe())
    ]
    return table(["stripe", "laser 1", "laser 2"], rows)


def gradients() -> str:
    return grid(SLOPED, plain, both, lambda s: f"{s.width_px:g} px, {s.gradient_dn_per_px:+g} DN/px")


def saturation() -> str:
    columns = [(x, n) for x in EXCESSES for n in (1.0, 3.0, 6.0)]
    rows = ([f"{s:g} px", *(both(saturated(Stripe(s, FULL_SCALE_DN * x, n))) for x, n in columns)] for s in WIDTHS)
    return table(["", *(f"{x:g}x/{n:g}" for x, n in columns)], rows)


def speckle(measure: Measure) -> str:
    parts = (f"C = {c:g}\n\n{grid(coarse(c), measure, both, by_width)}" for c in CONTRASTS)
    return "\n".join(parts)


def section() -> str:
    """The section with all its tables."""
    return f"""## Stripe centre

Written by `python -m tests.accuracy.report_stripe` (seed {SEED}; do not edit by hand); asserted by
`python -m pytest tests/accuracy`.

Every cell is a picture of {COLUMNS} columns, each a sampled Gaussian stripe of width s (px) and amplitude A (DN) on a
background of 20 DN with noise n (DN), at a random sub-pixel phase, clipped and rounded to 8 bits
(`tests/accuracy/synthetic_columns.py`). The generator shares no code with the estimator, but it is of the same family:
read these numbers as floors. The **ratio** is the RMS error of the centre over the Cramer-Rao bound
(`tests/accuracy/bounds.py`; rounding counts as variance 1/12, amplitude, width and background are unknown; speckle of
contrast C and shot noise enter as `n^2 + 1/12 + m/K + C^2 m^2`; clipped pixels by the censored likelihood); with
{COLUMNS} columns it has a standard deviation of 1.1 %. **sd** is the RMS of the reported standard deviation over the
RMS error. Where nothing else is said the noise is not given: it is estimated from the picture itself, as by default.
"Gross" are centres more than 1 px and more than 5 bounds off (at most {percent(GROSS_MUST)}); "astray" those more than
three widths off: another peak was taken for the stripe. Only the latter are left out of ratio and sd; below they are
listed with the ratio of all.
Cells are named s-A-n, then g (gradient), C (contrast), K (electrons per DN).

### Against the goals

{summary()}
Cells that miss a must:

{misses()}
Cells with centres astray:

{astray_cells()}
### Methods on the same pixels

Median / worst ratio over the cells of the grid (largest share astray where over {percent(GROSS_MUST)}); gradient
2 DN/px of either sign; speckle of C = 0.37 at amplitudes of 40 and 80 DN. Pixel locking: worst width.

{methods()}
### Additive noise

Ratio and sd; columns are A/n.

{grid(ADDITIVE, plain, both, by_width)}
### Ambient gradient

On a background of 95 DN. Ratio and sd; columns are A/n.

{gradients()}
### Saturation

Amplitude in units of {FULL_SCALE_DN:g} DN, the one that just reaches the top of the scale. Ratio and sd; columns are
excess/n. The bound is that of an unbiased estimator from one column alone. Where a flank falls between two pixels it is
very wide, and an estimator that knows the stripe to lie between the clipped pixels and the next ones does better:
therefore ratios below 1 for narrow stripes.

{saturation()}
### Speckle, noise model given

Ratio and sd; columns are A/n. Grains are one pixel wide and independent.

{speckle(given)}
### Speckle, noise model estimated from the picture itself

{speckle(plain)}
### Shot noise, noise model given (20 electrons per DN)

{grid(SHOT, given, both, by_width)}
### Pixel locking

Mean error at {situations.LOCKING_PHASES} phases of {situations.LOCKING_COLUMNS} columns each, A = 160, n = 1
(must 0.005 px, aim 0.002 px).

{locking()}
### Detection

Camera pictures of {situations.CAMERA_ROWS} rows; in those with gaps every other run of {situations.GAP_COLUMNS} columns
is dark.

{detection()}
### At the border of the picture

Centres uniformly 0 to 3 widths inside the border; ratio to each column's own bound for the pixels that are left.

{border()}
### Two lasers in one picture

Found in bands given in the reverse order of their rows; ratio of each.

{two_lasers()}
### Colour and texture

A red stripe on a grey texture of {situations.TEXTURE_DN:g} DN RMS and a grain of {situations.TEXTURE_GRAIN_PX:g} px,
on 60 DN. RMS error, and its ratio to the bound of as many exposures as enter the difference.

{texture()}"""


if __name__ == "__main__":
    write_section("stripe centre", section(), sys.argv[1:])
