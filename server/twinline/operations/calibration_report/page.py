"""The calibration report as one HTML page that needs nothing else: style and pictures are inside."""

import math
from importlib.resources import files

from twinline.calibration.scanner_evidence import (
    GOOD_SHAPE_SD_MM,
    REFUSED_AGREEMENT_MM,
    REFUSED_REJECTED,
    REFUSED_SHAPE_SD_MM,
)
from twinline.operations.calibration_report.comparison import same_scan, thesis_method
from twinline.operations.calibration_report.markup import length, number, percent, section, sentence, table, text
from twinline.operations.calibration_report.model import CalibrationReport, ScanUnderRig
from twinline.operations.calibration_report.sections import board_views, origin, parameters, residuals

_ICONS = {
    "good": '<path d="M7 13.5l4 4 8.5-9.5"/>',
    "usable": '<path d="M13 7.5v7"/><path d="M13 18.4v.2"/>',
    "refused": '<path d="M8.5 8.5l9 9M17.5 8.5l-9 9"/>',
}
_WORDS = {
    "good": ("Good", "Every limit is kept. The rig can be used as it is."),
    "usable": ("Usable, with reservations", "The rig was written. Know what is weak about it:"),
    "refused": ("Refused", "No rig was written; the one in use stays in force. The cause, and what to do next:"),
}
_HATCH = (
    '<svg width="0" height="0" aria-hidden="true" style="position:absolute"><defs><pattern id="unseen" width="6" '
    'height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)"><rect width="6" height="6" '
    'style="fill:var(--surface-2)"/><line y2="6" style="stroke:var(--line-strong);stroke-width:2"/></pattern></defs>'
    "</svg>"
)


def render_page(report: CalibrationReport) -> str:
    """The page, as a whole document."""
    style = files("twinline.operations.calibration_report").joinpath("style.css").read_text(encoding="utf-8")
    sections = [
        ("scan", "Before and after", same_scan(report)),
        ("residuals", "Residuals", residuals(report)),
        ("parameters", "Parameters", parameters(report)),
        ("views", "Board views", board_views(report)),
        ("thesis", "Thesis method", thesis_method(report)),
        ("origin", "From what", origin(report)),
        ("limits", "Limits", _limits()),
    ]
    shown = [(anchor, name, content) for anchor, name, content in sections if content]
    links = "".join(f'<li><a href="#{anchor}">{name}</a></li>' for anchor, name, _ in shown)
    body = "".join(content for _, _, content in shown)
    title = f"Calibration of {report.capture}: {report.verdict}"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{text(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n{_HATCH}{_top(report)}\n"
        f'<main>{_verdict(report)}<nav aria-label="Parts of this report"><ul>{links}</ul></nav>\n{body}</main>\n'
        f"<footer>Made by Twinline {text(report.version)}. The same numbers for programs: "
        "<code>twinline calibrate --report F --json</code>.</footer>\n</body>\n</html>\n"
    )


def _top(report: CalibrationReport) -> str:
    moment = report.made.replace("T", " ")[:16]
    rig = f"rig {text(report.rig)}, {text(report.rig_id)}" if report.rig_id else "no rig"
    return (
        f'<header class="top"><h1>Calibration of {text(report.capture)}</h1>'
        f"<p>{text(moment)} UTC · {text(report.method)} method · {rig}</p></header>"
    )


def _verdict(report: CalibrationReport) -> str:
    word, lead = _WORDS[report.verdict]
    icon = (
        f'<svg class="icon" viewBox="0 0 26 26" aria-hidden="true"><circle cx="13" cy="13" r="11.5" fill="none" '
        f'stroke="currentColor" stroke-width="2"/><g fill="none" stroke="currentColor" stroke-width="2.4" '
        f'stroke-linecap="round" stroke-linejoin="round">{_ICONS[report.verdict]}</g></svg>'
    )
    reasons = "".join(f"<li>{text(reason)}</li>" for reason in report.reasons)
    listed = f"<ol>{reasons}</ol>" if reasons else ""
    code = f'<p class="note">For programs: <code>{text(report.code)}</code></p>' if report.code else ""
    return (
        f'<div class="verdict {report.verdict}" role="status"><h2>{icon}{word}</h2><p>{lead}</p>{listed}{code}'
        f"{_key_figures(report)}</div>"
    )


def _key_figures(report: CalibrationReport) -> str:
    """The five numbers by which a reader judges, each with what it was or may be."""
    found: list[tuple[str, str, str]] = []
    evidence = report.evidence
    if evidence is not None and report.method == "joint" and report.groups:
        found.append(
            (
                "Shape of a scan, uncertain by",
                f"± {length(evidence.shape_sd_mm)} <small>mm</small>",
                f"good up to {GOOD_SHAPE_SD_MM:g} mm",
            )
        )
    before = next((s for s in report.scans if s.label == "before"), None)
    chosen = next((s for s in report.scans if s.label == report.method), None)
    if chosen is not None:
        found += _agreements(chosen, before)
    if evidence is not None and report.method == "joint":
        if report.groups:
            groups = [g.figures for g in report.groups]
            count = sum(g.observations for g in groups)
            rejected = sum(g.rejected_share * g.observations for g in groups) / max(count, 1)
            found.append(("Observations rejected", percent(rejected), f"of {number(count, 0)} groups"))
        camera = evidence.camera_held_out_px
        if math.isfinite(camera):
            found.append(("Camera, views held out", f"{number(camera, 3)} <small>px</small>", "root mean square"))
    items = "".join(
        f'<div><dt>{name}</dt><dd>{value}<span class="limit">{limit}</span></dd></div>' for name, value, limit in found
    )
    return f'<dl class="keys">{items}</dl>' if items else ""


def _agreements(chosen: ScanUnderRig, before: ScanUnderRig | None) -> list[tuple[str, str, str]]:
    earlier = {p.figures.pair: p.figures.typical_mm for p in before.pairs} if before is not None else {}
    return [
        (
            f"{text(sentence(p.figures.pair))}, typical",
            f"{length(p.figures.typical_mm)} <small>mm</small>",
            f"before {length(earlier[p.figures.pair])} mm" if p.figures.pair in earlier else "",
        )
        for p in chosen.pairs
    ]


def _limits() -> str:
    rows = [
        ["Shape of a scan, 1σ", f"{GOOD_SHAPE_SD_MM:g} mm", f"{REFUSED_SHAPE_SD_MM:g} mm"],
        ["Two sensors at the same place, typical size", "–", f"{REFUSED_AGREEMENT_MM:g} mm"],
        ["Observations of one kind rejected", "20 %", percent(REFUSED_REJECTED)],
    ]
    numbers = table("Limits of the joint method's verdict", ["Figure", "Good up to", "Refused above"], rows)
    words = (
        "<p>The verdict is about what the observations determine. A small residual alone proves nothing: it stays "
        "small where a parameter cannot be seen. So the verdict also looks at held-out groups, at what a prior holds, "
        "and at the uncertainty that the whole calibration gives to the shape of a scan. Board views, travel and "
        "sensor overlap are refused one by one before, each with its cause.</p>"
    )
    return section("limits", "How the verdict is reached", "", numbers, words)
