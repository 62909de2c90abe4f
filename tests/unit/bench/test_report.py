"""A run as JSON, as text, and in the document."""

import json
from pathlib import Path

import numpy as np
import pytest

from twinline.bench.figures import Figure, Machine, Quartiles, Ratio, Report, Section, Verdict
from twinline.bench.report import BEGIN, END, to_json, to_markdown, to_text, write_markdown
from twinline.errors import OutputError


def report(ratio: float = 3.0) -> Report:
    value = Quartiles.of(np.array([ratio - 1, ratio, ratio + 1]))
    figures = (
        Figure("pass", Quartiles(20.0, 19.0, 21.0), "us"),
        Figure("stripes", Quartiles(61.2, 60.0, 65.0), "us", (Ratio("pass", value, 4.0, 2.0), Ratio("other", value))),
    )
    machine = Machine("a processor", 4, ("L2 2048K",), "Linux x86_64", (("twinline", "0.1.0"), ("python", "3.11")))
    return Report("2026-01-02", machine, (Section("key", "Title", "How.", 5, figures),))


@pytest.mark.parametrize(
    ("ratio", "verdict"),
    [(2.0, "meets the aim"), (2.1, "meets the must"), (4.0, "meets the must"), (4.1, "MISSES THE MUST")],
)
def test_the_median_decides(ratio: float, verdict: Verdict) -> None:
    run = report(ratio)
    promised, other = run.sections[0].figure("stripes").ratios
    assert promised.verdict == verdict
    assert other.verdict == ""
    assert run.missed == (("Title: stripes",) if verdict == "MISSES THE MUST" else ())


def test_json_holds_everything_with_the_verdicts() -> None:
    document = json.loads(to_json(report(5.0)))
    assert document["date"] == "2026-01-02"
    assert document["machine"]["versions"] == {"twinline": "0.1.0", "python": "3.11"}
    assert document["missed"] == ["Title: stripes"]
    figure = document["sections"][0]["figures"][1]
    assert figure["value"] == {"median": 61.2, "low": 60.0, "high": 65.0}
    assert figure["ratios"][0] == {
        "against": "pass",
        "value": {"median": 5.0, "low": 4.5, "high": 5.5},
        "must": 4.0,
        "aim": 2.0,
        "verdict": "MISSES THE MUST",
    }


def test_the_text_names_figure_ratio_target_and_verdict() -> None:
    text = to_text(report())
    line = next(line for line in text.splitlines() if line.startswith("stripes"))
    assert " ".join(line.split()) == "stripes 61.2 us 60.0 to 65.0 pass 3.00 x 2.50 to 3.50 4 / 2 meets the must"


def test_only_what_is_between_the_markers_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "PERFORMANCE.md"
    path.write_text(f"# Before\n\n{BEGIN}\nold\n{END}\n\nAfter.\n", encoding="utf-8")
    write_markdown(path, report())
    text = path.read_text(encoding="utf-8")
    assert text == f"# Before\n\n{to_markdown(report())}\n\nAfter.\n"
    assert "| stripes | 61.2 us |" in text
    write_markdown(path, report())
    assert path.read_text(encoding="utf-8") == text


@pytest.mark.parametrize("text", ["", BEGIN, f"{END}\n{BEGIN}", f"{BEGIN}\n{END}\n{BEGIN}\n{END}"])
def test_a_document_without_one_pair_of_markers_is_left_alone(tmp_path: Path, text: str) -> None:
    path = tmp_path / "PERFORMANCE.md"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(OutputError, match=r"PERFORMANCE\.md must hold one pair"):
        write_markdown(path, report())
    assert path.read_text(encoding="utf-8") == text


def test_a_missing_document_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere\.md cannot be read"):
        write_markdown(tmp_path / "nowhere.md", report())
