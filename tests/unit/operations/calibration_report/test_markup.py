import re

import pytest

from twinline.operations.calibration_report.markup import length, number, percent, table, text


@pytest.mark.parametrize(
    ("value", "decimals", "words"),
    [(-0.0004, 3, "0.000"), (-1.5, 1, "−1.5"), (12345.6, 1, "12\u202f345.6"), (0.0, 0, "0")],
)
def test_numbers_have_a_true_minus_and_no_minus_before_zero(value: float, decimals: int, words: str) -> None:
    assert number(value, decimals) == words


def test_what_is_not_known_says_so_to_a_screen_reader_too() -> None:
    for words in (number(float("nan"), 2), length(float("inf")), percent(float("nan"))):
        assert "not known" in re.sub(r"<[^>]*>", "", words)


@pytest.mark.parametrize(("value", "words"), [(0.0716, "0.072"), (4.4901, "4.49"), (143.52, "143.5")])
def test_lengths_show_the_digits_that_matter(value: float, words: str) -> None:
    assert length(value) == words


def test_names_from_outside_cannot_become_markup() -> None:
    assert text('<script>"&') == "&lt;script&gt;&quot;&amp;"


def test_every_row_of_a_table_has_a_header_cell() -> None:
    made = table("Caption", ["Name", "Number"], [["a", "1"], ["b", "2"]])
    assert made.count('<th scope="row">') == 2
    assert made.count('<th scope="col"') == 2
    assert "<caption>Caption</caption>" in made
