"""The parts of a calibration report's page that compare: the same scan under each rig, and the thesis's method."""

import math

from twinline.calibration.scanner_evidence import REFUSED_AGREEMENT_MM
from twinline.operations.calibration_report.figures import (
    SENSOR_CSS,
    colour_scale,
    convergence_plot,
    difference_histogram,
    difference_map,
    profile_plot,
)
from twinline.operations.calibration_report.markup import (
    NOT_KNOWN,
    figure,
    length,
    number,
    section,
    sentence,
    table,
    text,
)
from twinline.operations.calibration_report.model import CalibrationReport, Convergence, PairReport, ScanUnderRig

TITLES = {"before": "Before: starting rig", "thesis": "Thesis method", "joint": "Joint adjustment"}


def same_scan(report: CalibrationReport) -> str:
    """The same stripes and readings under each rig."""
    if not report.scans:
        return ""
    lead = (
        "The same stripes and readings, turned into heights with each rig. Where two sensors saw the same place, a "
        "right rig gives one height. All maps have one scale; the histograms have their own."
    )
    names = [pair.figures.pair for pair in report.scans[-1].pairs]
    parts = []
    if names:
        parts.append(_agreement_table(report))
        parts.append(colour_scale(report.scans[-1].pairs[0].differences.reach_mm))
    for name in names:
        cards = "".join(_map_card(scan, name, report) for scan in report.scans)
        parts.append(f'<div class="pair"><h3>{text(_minus(name))}</h3><div class="three">{cards}</div></div>')
    if any(scan.profiles for scan in report.scans):
        parts.append(_profiles(report))
    return section("scan", "The same scan before and after", lead, *parts)


def _minus(pair: str) -> str:
    first, _, second = pair.partition(" against ")
    return sentence(f"{first} minus {second}") if second else pair


def _pair(scan: ScanUnderRig, name: str) -> PairReport | None:
    return next((pair for pair in scan.pairs if pair.figures.pair == name), None)


def _agreement_table(report: CalibrationReport) -> str:
    names = dict.fromkeys(pair.figures.pair for scan in report.scans for pair in scan.pairs)
    rows = []
    for name in names:
        found = [_pair(scan, name) for scan in report.scans]
        words = text(sentence(name))
        rows.append([f"{words}, on objects", *_best_marked([(p.figures.typical_mm if p else math.nan) for p in found])])
        tails = [length(p.figures.p90_mm) if p is not None else NOT_KNOWN for p in found]
        rows[-1][1:] = [f"{cell} <small>90 %: {tail}</small>" for cell, tail in zip(rows[-1][1:], tails, strict=True)]
        rows.append([f"{words}, on the bed", *_best_marked([(p.bed_typical_mm if p else math.nan) for p in found])])
    return table(
        "How far two sensors differ in height, typical size in mm",
        ["Sensors", *(TITLES[scan.label] for scan in report.scans)],
        rows,
        note="Typical: half of the differences are smaller; 90 %: nine in ten are. This is the scan that the rigs were "
        "calibrated from, so the numbers show what is left of it; they are no proof of accuracy elsewhere. A "
        f"calibration is refused above {REFUSED_AGREEMENT_MM:g} mm on objects.",
    )


def _best_marked(sizes: list[float]) -> list[str]:
    smallest = min((size for size in sizes if math.isfinite(size)), default=math.nan)
    return [f"<b>{length(size)}</b>" if size == smallest else length(size) for size in sizes]


def _map_card(scan: ScanUnderRig, name: str, report: CalibrationReport) -> str:
    pair = _pair(scan, name)
    title, css = TITLES[scan.label], ""
    if scan.label == report.method and report.rig_id:
        title, css = f"{title}: this rig", "chosen"
    if pair is None:
        return figure("", "These sensors saw too little in common under this rig.", title=title, css=css)
    label = f"Map of {_minus(name)} over the bed, {title}: {pair.figures.median_mm:.3f} mm in the middle"
    drawing = difference_map(pair.differences, label) + difference_histogram(pair)
    words = (
        f"On objects {length(pair.figures.median_mm)} mm in the middle, {length(pair.figures.typical_mm)} mm typical "
        f"size, {number(pair.figures.cells, 0)} places"
    )
    return figure(drawing, words, title=title, css=css)


def _profiles(report: CalibrationReport) -> str:
    cards = "".join(
        figure(profile_plot(scan, TITLES[scan.label]), "", title=TITLES[scan.label], css="")
        for scan in report.scans
        if scan.profiles
    )
    sensors = dict.fromkeys(p.sensor for scan in report.scans for p in scan.profiles)
    key = "".join(f'<span class="key"><i class="{SENSOR_CSS.get(s, "other")}"></i>{text(s)}</span>' for s in sensors)
    return (
        '<div class="pair"><h3>Profile along the travel, where it cuts the most of the objects</h3>'
        f"<p>{key}</p><p class='note'>The height axes differ: each shows its whole profile.</p>"
        f'<div class="three">{cards}</div></div>'
    )


def thesis_method(report: CalibrationReport) -> str:
    """The thesis's method on the same data, with the convergence graphs of its Nelder-Mead runs.

    Nothing where the capture could not be read to the end, so that it was not tried.
    """
    thesis = report.thesis
    if not thesis.failure and not thesis.runs:
        return ""
    lead = (
        "Two laser fits of baseline d and angle θ against ToF heights, a shift of laser 1 along the travel, and an "
        "alignment of the ToF sensor to both, each by Nelder-Mead. Its rig stands beside the joint one above."
    )
    if thesis.failure:
        return section("thesis", "Thesis method", lead, f"<p><b>It gave no result.</b> {text(thesis.failure)}</p>")
    steps = "".join(f"<dt>{text(name)}</dt><dd>{text(words)}</dd>" for name, words in thesis.steps)
    reasons = "".join(f"<li>{text(reason)}</li>" for reason in thesis.reasons)
    lasers = [
        (run.name.lower(), SENSOR_CSS[run.name.lower()], run) for run in thesis.runs if run.name.lower() in SENSOR_CSS
    ]
    others = [run for run in thesis.runs if run.name.lower() not in SENSOR_CSS]
    graphs = [
        figure(convergence_plot(lasers, series, label, log=log), "", title=title)
        for series, label, title, log in (
            ("value", "sum of |Z ToF − Z laser|, mm", "Laser fits: what is minimised", True),
            ("baseline_mm", "d, mm", "Laser fits: baseline", False),
            ("angle_deg", "θ, degrees", "Laser fits: angle", False),
            ("simplex", "mm or degrees", "Laser fits: size of the simplex", True),
        )
    ]
    for run in others:
        graphs += _alignment_graphs(run)
    return section(
        "thesis",
        "Thesis method",
        lead,
        f"<dl class='pairs'>{steps}</dl>",
        f"<h3>What makes it weaker</h3><ul class='plain'>{reasons}</ul>" if reasons else "",
        "<h3>Convergence of the Nelder-Mead runs</h3>"
        "<p class='note'>Dotted uprights: the search began anew around its best point with a fresh simplex.</p>",
        f'<div class="three">{"".join(graphs)}</div>',
        _run_table(thesis.runs),
    )


def _alignment_graphs(run: Convergence) -> list[str]:
    value = convergence_plot([(run.name, "accent", run)], "value", run.value_name, log=False)
    return [
        figure(value, "", title=f"{text(run.name)}: what is minimised"),
        figure(_parameter_plot(run), "", title=f"{text(run.name)}: shift"),
    ]


def _parameter_plot(run: Convergence) -> str:
    """All parameters of an alignment in one drawing, as if each were a run."""
    styles = ("first", "second", "third", "")
    names = list(run.parameters)
    single = [
        (
            name.removesuffix("_mm").removesuffix("_deg").replace("_", " "),
            styles[i % len(styles)],
            Convergence(
                name, "", run.parameters[name], {}, run.simplex_size, run.restarts, run.evaluations, run.settled_after
            ),
        )
        for i, name in enumerate(names)
    ]
    label = "shift, mm" if all(name.endswith("_mm") for name in names) else "shift, mm; turn, degrees"
    return convergence_plot(single, "value", label, log=False)


def _run_table(runs: tuple[Convergence, ...]) -> str:
    rows = [
        [
            text(run.name),
            text(run.value_name),
            text(f"{run.values[0]:.5g}"),
            text(f"{run.values[-1]:.5g}"),
            number(len(run.values) - 1, 0),
            number(run.settled_after, 0),
            number(run.evaluations, 0),
            number(len(run.restarts), 0),
        ]
        for run in runs
    ]
    head = ["Run", "Minimised", "At first", "At last", "Iterations", "99 % reached after", "Evaluations", "Restarts"]
    return table("Nelder-Mead runs", head, rows, words=(0, 1))
