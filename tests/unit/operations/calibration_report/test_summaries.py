import numpy as np
import pytest

from twinline.operations.calibration_report.summaries import histogram, round_reach


def test_a_histogram_loses_no_value() -> None:
    values = np.array([-3.0, -1.0, -0.5, 0.0, 0.99, 1.0, 7.0, 8.0, np.nan])
    found = histogram(values, 1.0, bins=4)
    assert found.total == 8
    assert (found.below, found.above) == (1, 2)
    assert found.counts == (1, 1, 1, 2)
    assert found.low + len(found.counts) * found.width == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("value", "reach"), [(0.0, 0.01), (0.011, 0.02), (0.2, 0.2), (0.64, 1.0), (53.0, 100.0), (float("nan"), 0.01)]
)
def test_scales_end_at_round_numbers(value: float, reach: float) -> None:
    assert round_reach(value) == pytest.approx(reach)
