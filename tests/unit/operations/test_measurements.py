import numpy as np
import pytest

from tests.unit.fusion.inspection.surfaces import block_points
from twinline.errors import InputError
from twinline.operations.measurements import MEASUREMENTS, measure


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 45.0])
def test_the_volume_over_the_bed_is_that_of_the_block(angle_deg: float) -> None:
    points = block_points((25.4, 24.2, 19.35), angle_deg=angle_deg, noise_mm=0.03)
    found = measure("volume", points, None, [])
    volume, area = found.quantities["volume"], found.quantities["area"]
    assert abs(volume.value - 25.4 * 24.2 * 19.35) < 3.0 * volume.sigma < 0.1 * volume.value
    assert abs(area.value - 25.4 * 24.2) < 3.0 * area.sigma
    assert found.details["highest_mm"] == pytest.approx(19.35, abs=0.15)
    # What it used is the block's top, and hardly anything of the bed.
    assert (points[found.used, 2] > 19.0).mean() > 0.97
    assert len(found.used) > 0.97 * (points[:, 2] > 19.0).sum()


def test_every_measurement_refuses_a_cloud_without_measured_points() -> None:
    for name in MEASUREMENTS:
        with pytest.raises(InputError):
            measure(name, np.full((500, 3), np.nan), None, [np.ones(500, dtype=bool), np.ones(500, dtype=bool)])


def test_rows_are_those_of_the_whole_cloud_whatever_the_region() -> None:
    points = block_points((25.4, 24.2, 19.35), noise_mm=0.03)
    region = points[:, 2] < 5.0
    found = measure("plane", points, None, [region])
    assert region[found.used].all()
    assert len(found.used) > 0.98 * region.sum()
