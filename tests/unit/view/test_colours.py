import numpy as np
import pytest

from tests.unit.operations.fakes import some_points
from twinline.fusion.cloud import PointCloud, Source
from twinline.operations.display import ColourMode
from twinline.view.colours import SCALED, colours, scalar, value_range


@pytest.mark.parametrize("mode", list(ColourMode))
def test_every_mode_colours_every_point(mode: ColourMode) -> None:
    cloud = some_points(20)
    values = scalar(cloud, mode)
    assert (values is not None) == (mode in SCALED)
    ends = value_range([values])
    assert colours(cloud, mode, ends).shape == (20, 3)
    assert colours(cloud, mode, ends).dtype == np.uint8
    assert colours(PointCloud.empty(), mode, None).shape == (0, 3)


def test_a_larger_value_is_lighter() -> None:
    cloud = some_points(500)
    order = np.argsort(cloud.points_mm[:, 2])
    rgb = colours(cloud, ColourMode.HEIGHT, (0.0, 20.0))[order].astype(float)
    luminance = rgb @ (0.2126, 0.7152, 0.0722)
    # One grey level of each channel is lost to rounding.
    assert (np.diff(luminance) >= -1.0).all()
    assert luminance[-1] - luminance[0] > 100


def test_what_lies_beyond_the_ends_has_the_colour_of_the_end() -> None:
    cloud = some_points(500)
    rgb = colours(cloud, ColourMode.HEIGHT, (5.0, 6.0))
    low, high = cloud.points_mm[:, 2] <= 5.0, cloud.points_mm[:, 2] >= 6.0
    assert len(np.unique(rgb[low], axis=0)) == 1
    assert len(np.unique(rgb[high], axis=0)) == 1


def test_points_without_a_number_are_grey_and_do_not_move_the_scale() -> None:
    cloud = some_points(100)
    cloud.sigma_mm[3] = np.nan
    ends = value_range([scalar(cloud, ColourMode.SIGMA)])
    assert ends is not None
    assert np.isfinite(ends).all()
    np.testing.assert_array_equal(colours(cloud, ColourMode.SIGMA, ends)[3], (128, 128, 128))


def test_a_few_wild_points_do_not_wash_out_the_scale() -> None:
    values = np.linspace(0.0, 10.0, 1000)
    values[:5] = 1e6
    ends = value_range([values[:400], None, values[400:]])
    assert ends is not None
    assert ends[1] < 21.0


def test_the_top_of_a_small_object_on_a_large_bed_is_on_the_scale() -> None:
    rng = np.random.default_rng(5)
    values = np.concatenate([rng.normal(0.0, 0.05, 50_000), np.linspace(0.0, 19.0, 1200), np.linspace(19.0, 28.0, 200)])
    ends = value_range([values])
    assert ends is not None
    assert ends[1] > 24.0


def test_sources_have_colours_that_differ() -> None:
    cloud = some_points(len(Source))
    cloud.source[:] = list(Source)
    assert len(np.unique(colours(cloud, ColourMode.SOURCE, None), axis=0)) == len(Source)


def test_no_values_have_no_range() -> None:
    assert value_range([]) is None
    assert value_range([None, np.array([np.nan])]) is None
