"""The parts of a calibration report's page that show what it was calibrated from and what came out."""

import math

from twinline.calibration.scanner_evidence import GOOD_REJECTED, HIGH_CORRELATION, REFUSED_REJECTED
from twinline.operations.calibration_report.figures import (
    corner_picture,
    residual_histogram,
    tilt_picture,
)
from twinline.operations.calibration_report.markup import (
    NOT_KNOWN,
    figure,
    folded,
    length,
    number,
    percent,
    section,
    sentence,
    table,
    text,
)
from twinline.operations.calibration_report.model import CalibrationReport, CoverageReport, Quantity, ViewReport

_SEEN = {
    "seen": '<span class="mark ok">✓ seen</span>',
    "prior": '<span class="mark warn">! held by prior</span>',
    "fixed": '<span class="mark off">– not adjusted</span>',
}
_PARTS = {
    "camera": "Camera",
    "travel": "Travel",
    "bed_from_camera": "Pose over the bed",
    "sheets": "Laser sheets",
    "tof": "ToF sensor",
}


def origin(report: CalibrationReport) -> str:
    """What was calibrated, and from what."""
    used = "".join(f"<li>{text(part)}</li>" for part in report.parts_used)
    sources = "".join(
        f"<dt>{_PARTS.get(part, text(part))}</dt><dd>{text(sentence(source))}</dd>"
        for part, source in report.sources.items()
    )
    parts = [f"<h3>The capture holds</h3><ul class='plain'>{used or '<li>nothing that can be used</li>'}</ul>"]
    if sources:
        title = "Where each part of the rig comes from" if report.rig_id else "Where the parts came from before"
        parts.append(f"<h3>{title}</h3><dl class='pairs'>{sources}</dl>")
    notes = report.evidence.notes if report.evidence is not None else ()
    if notes:
        parts.append(f"<h3>Notes</h3><ul class='plain'>{''.join(f'<li>{text(n)}</li>' for n in notes)}</ul>")
    return section("origin", "From what", "", *parts)


def residuals(report: CalibrationReport) -> str:
    """Residuals of the joint adjustment: all, and held out."""
    if not report.groups:
        if report.method == "joint" or not report.joint_failure:
            return ""
        words = f"<p><b>The joint adjustment gave no result.</b> {text(report.joint_failure)}</p>"
        return section("residuals", "Residuals", "", words)
    rows = [
        [
            text(sentence(g.figures.kind)),
            number(g.figures.observations, 0),
            length(g.figures.rms_mm),
            length(g.figures.held_out_mm),
            length(g.figures.mean_mm),
            _rejected(g.figures.rejected_share),
        ]
        for g in report.groups
    ]
    numbers = table(
        "Residuals of the joint adjustment",
        ["Observation", "Groups", "RMS, all, mm", "RMS, held out, mm", "Mean, mm", "Rejected"],
        rows,
        note="A group is all that one sensor measured in one patch, and counts once. RMS, all: no group is left out "
        "for its size. Held out: a fifth of the groups, under an adjustment that did without them; much more than RMS "
        "means that the adjustment follows noise. Rejected: the robust loss gave them less than a tenth of their "
        "weight.",
    )
    pictures = "".join(figure(residual_histogram(g), "", title=text(sentence(g.figures.kind))) for g in report.groups)
    key = (
        '<p><span class="key"><i class="bar"></i>all groups</span><span class="key"><i class="gone"></i>rejected '
        'among them</span><span class="key"><i class="held"></i>held out</span></p>'
    )
    lead = "How far the observations lie from the calibrated scanner, along the normal of the surface."
    return section("residuals", "Residuals", lead, numbers, f"{key}<div class='three'>{pictures}</div>")


def _rejected(share: float) -> str:
    if share > REFUSED_REJECTED:
        return f'<span class="mark fail">✕ {percent(share)}</span>'
    if share > GOOD_REJECTED:
        return f'<span class="mark warn">! {percent(share)}</span>'
    return percent(share)


def parameters(report: CalibrationReport) -> str:
    """What was found, before and after, how sure, and what is not seen."""
    if not report.quantities:
        return ""
    by_joint = report.evidence is not None
    head = ["Property", "Before", "Thesis", "Joint", "± 1σ", "In the data"]
    parts = []
    for part in dict.fromkeys(q.part for q in report.quantities):
        rows = [_quantity(q, by_joint) for q in report.quantities if q.part == part]
        parts.append(table(part, head, rows, words=(0, 5)))
    lead = (
        "Brackets: taken as given, not found. Held by prior: the observations leave more than half of the variance "
        "that a ruler and a data sheet left; the number is plausible, not measured."
    )
    tables = f'<div class="params">{"".join(parts)}</div>'
    return section("parameters", "Parameters, before and after", lead, tables, _correlations(report), _raw(report))


def _quantity(q: Quantity, by_joint: bool) -> list[str]:
    name = text(sentence(q.name)) + (f' <span class="given">{q.unit}</span>' if q.unit else "")
    thesis = number(q.thesis, q.decimals)
    if math.isfinite(q.thesis) and q.thesis == q.before:
        thesis = f'<span class="given">({thesis})</span>'
    joint = number(q.joint, q.decimals)
    if by_joint and q.seen == "fixed":
        joint = f'<span class="given">({joint})</span>'
    sd = number(q.sd, q.decimals + 1) if q.seen != "fixed" else NOT_KNOWN
    return [
        name, number(q.before, q.decimals), thesis, f"<b>{joint}</b>", sd, _SEEN[q.seen] if by_joint else NOT_KNOWN
    ]  # fmt: skip


def _correlations(report: CalibrationReport) -> str:
    if report.evidence is None:
        return ""
    pairs = report.evidence.correlations
    if not pairs:
        return f"<p>No two parameters are correlated by more than {HIGH_CORRELATION:g}.</p>"
    rows = [[f"<code>{text(a)}</code> and <code>{text(b)}</code>", number(r, 3)] for a, b, r in pairs]
    counted = table(
        f"Parameters correlated by more than {HIGH_CORRELATION:g}",
        ["Pair", "Correlation"],
        rows,
        note="The data fix a combination of such a pair better than either alone. That does no harm to a scan of the "
        "same volume; it does where the rig is used beyond it.",
    )
    return folded(f"{len(pairs)} pairs of parameters correlated by more than {HIGH_CORRELATION:g}", counted)


def _raw(report: CalibrationReport) -> str:
    if report.evidence is None or not report.evidence.parameters:
        return ""
    rows = [
        [f"<code>{text(p.name)}</code>", text(f"{p.value:.8g}"), text(f"{p.sd:.2g}"), percent(p.from_prior)]
        for p in report.evidence.parameters
    ]
    return folded(
        f"All {len(rows)} adjusted parameters as the mathematics has them",
        table(
            "Adjusted parameters, in the camera's frame at cart position 0",
            ["Parameter", "Value", "Standard deviation", "Variance left of the prior's"],
            rows,
            note="Sheets: 1/Z = a x + b y + c on the ray (x, y, 1). Bed: bed · p = 1. Lengths in mm, lag in s.",
        ),
    )


def board_views(report: CalibrationReport) -> str:
    """Coverage of image and tilts, and the verdict on every picture."""
    coverage = report.coverage
    if coverage is None:
        return ""
    used = sum(view.used for view in coverage.views)
    pictures = "<div class='two'>" + figure(
        corner_picture(coverage),
        "Dots: corners used. Crosses: corners of views that were not. The lens is known where there are dots.",
        title=f"Corners in the image of {coverage.image_size[0]} × {coverage.image_size[1]} px",
    )
    pictures += (
        figure(
            tilt_picture(coverage),
            "Each dot is a view: how far its board was tilted and, where it is known, to which side. Tilts of 20° to "
            "45° to all sides fix the focal length; views nearly parallel to the board cannot tell it from the "
            "distance.",
            title="Tilts of the board",
        )
        + "</div>"
    )
    count = len(coverage.views)
    rest = (
        f"covering {percent(coverage.share)} of the image"
        if math.isfinite(coverage.share)
        else "no camera came of them"
    )
    return section(
        "views",
        "Board views",
        f"{used} of {count} pictures in camera/ are used, {rest}." if used else f"None of the {count} pictures in "
        "camera/ could be used for a camera; the verdict at the top says why.",
        pictures,
        _advice(coverage),
        folded(f"All {count} views with verdict and error", _view_table(coverage.views), opened=not used),
    )  # fmt: skip


def _advice(coverage: CoverageReport) -> str:
    if not coverage.advice:
        return ""
    rows = "".join(
        f'<li><span class="mark {"warn" if missing else "ok"}">{"!" if missing else "✓"}</span> {text(words)}</li>'
        for missing, words in coverage.advice
    )
    return f"<h3>Coverage</h3><ul class='plain'>{rows}</ul>"


def _view_mark(view: ViewReport) -> str:
    if view.used:
        return '<span class="mark ok">✓ used</span>'
    if view.verdict in ("found", "partial"):
        return f'<span class="mark off">– {text(view.verdict)}, not used</span>'
    return f'<span class="mark fail">✕ {text(view.verdict)}</span>'


def _view_table(views: tuple[ViewReport, ...]) -> str:
    rows = [
        [
            text(v.name),
            _view_mark(v),
            number(v.rms_px, 3),
            number(v.held_out_px, 3),
            number(v.tilt_deg, 0),
            text(v.reason) or "",
        ]
        for v in views
    ]
    return table(
        "Views",
        ["Picture", "Verdict", "RMS, px", "Held out, px", "Tilt, °", "What to do"],
        rows,
        words=(0, 1, 5),
        note="Held out: the error under a camera that was fitted without this view.",
    )
