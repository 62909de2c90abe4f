"""Filters that are one scoring step of a weighted least-squares fit."""

import itertools

import numpy as np
import pytest

from twinline.geometry.noise import NoiseModel
from twinline.stripe.tables import (
    LOWEST_AMPLITUDE_DN,
    SLOPE_SCALE,
    WIDTH_CLASSES,
    FilterTable,
    WidthClass,
    filter_table,
)

SMALL = WidthClass(32, 1, 1.0, 2.0, 3, 4)
ADDITIVE = NoiseModel(2.0)
SPECKLED = NoiseModel(2.0, speckle=0.2)


def node(table: FilterTable, phase: int, width: int) -> tuple[float, float]:
    c = table.width_class
    return (phase + 0.5) / c.phases - 0.5, c.narrowest + width * (c.widest - c.narrowest) / (c.widths - 1)


def taps(table: FilterTable) -> np.ndarray:
    return np.arange(table.width_class.taps) - (table.width_class.taps // 2 - 1)


@pytest.mark.parametrize("noise", [ADDITIVE, SPECKLED], ids=["additive", "speckled"])
@pytest.mark.parametrize(("phase", "width"), [(0, 0), (3, 1), (2, 2)])
def test_a_profile_at_a_node_is_read_off_exactly(noise: NoiseModel, phase: int, width: int) -> None:
    table = filter_table(SMALL, noise)
    mu, s = node(table, phase, width)
    k = taps(table)
    profile = 11.0 + 0.7 * k + 90.0 * np.exp(-((k - mu) ** 2) / (2 * s**2))
    for amplitude in range(table.filters.shape[0]):
        answer = table.filters[amplitude, width, phase, :5] @ profile
        assert answer == pytest.approx([90.0, 0.0, 0.0, 11.0, 0.7 / float(SLOPE_SCALE)], abs=2e-3)


def test_a_small_displacement_is_seen_as_amplitude_times_displacement() -> None:
    table = filter_table(SMALL, ADDITIVE)
    mu, s = node(table, 1, 1)
    k = taps(table)
    profile = 50.0 * np.exp(-((k - mu - 0.01) ** 2) / (2 * (s + 0.02) ** 2))
    answer = table.filters[0, 1, 1, :3] @ profile
    assert answer == pytest.approx([50.0, 0.5, 1.0], abs=0.02)


def test_the_filters_do_to_noise_what_the_table_says() -> None:
    table = filter_table(SMALL, SPECKLED)
    k = taps(table)
    for level, ia in ((LOWEST_AMPLITUDE_DN, 1), (LOWEST_AMPLITUDE_DN * 8, 4)):
        mu, s = node(table, 2, 1)
        signal = level * np.exp(-((k - mu) ** 2) / (2 * s**2))
        variance = 4.0 + (0.2 * signal) ** 2
        filters = table.filters[ia, 1, 2].astype(float)
        assert (filters[:3] ** 2 @ variance) ** 0.5 == pytest.approx(
            [table.sd_amplitude[ia, 1, 2], table.sd[ia, 1, 2], table.sd_width[ia, 1, 2]], rel=1e-4
        )
        weights = table.filters[ia, 1, 2, 5]
        used = weights > 0
        assert used[np.abs(k - mu) <= 6 * s].all()
        assert weights[used] == pytest.approx(1 / variance[used], rel=1e-5)
        assert not table.filters[ia, 1, 2, :5][:, ~used].any()


def test_the_sums_give_the_square_that_a_least_squares_fit_leaves() -> None:
    table = filter_table(SMALL, ADDITIVE)
    k = taps(table)
    profile = 11.0 + 0.7 * k + np.random.default_rng(3).normal(0.0, 2.0, k.size)
    a, p, q, b, g = (table.filters[0, 1, 2, :5] @ profile).astype(float)
    weights, n = table.filters[0, 1, 2, 5].astype(float), table.sums[0, 1, 2].astype(float)
    over = profile - b
    explained = a * (a * n[1] + 2 * (p * n[2] + q * n[3] + g * n[4])) + p * (p * n[5] + 2 * (q * n[6] + g * n[7]))
    explained += q * (q * n[8] + 2 * g * n[9]) + g * g * n[10]
    mu, s = node(table, 2, 1)
    m = np.exp(-((k - mu) ** 2) / (2 * s**2))
    model = a * m + p * m * (k - mu) / s**2 + q * m * (k - mu) ** 2 / s**3 + g * float(SLOPE_SCALE) * k
    assert weights @ over**2 - explained == pytest.approx(weights @ (over - model) ** 2, rel=1e-3)
    assert n[0] == pytest.approx(weights.sum(), rel=1e-5)
    assert n[11] == (weights > 0).sum() - 5


def test_noise_that_does_not_grow_with_the_light_needs_one_amplitude() -> None:
    assert filter_table(SMALL, ADDITIVE).filters.shape[0] == 1
    assert filter_table(SMALL, SPECKLED).filters.shape[0] == 7
    assert filter_table(SMALL, NoiseModel(2.0, electrons_per_dn=30.0)).filters.shape[0] == 7


def test_averaging_pixels_into_a_tap_lowers_its_noise() -> None:
    single, double = (filter_table(WidthClass(32, b, 1.0, 2.0, 3, 4), ADDITIVE) for b in (1, 2))
    assert double.sd == pytest.approx(single.sd / np.sqrt(2), rel=1e-5)


def test_tables_are_kept_for_equal_noise() -> None:
    assert filter_table(SMALL, NoiseModel(3.5)) is filter_table(SMALL, NoiseModel(3.5))


def test_the_width_classes_leave_no_gap() -> None:
    reach = [(c.narrowest * c.binning, c.widest * c.binning) for c in WIDTH_CLASSES]
    for (_, end), (start, _) in itertools.pairwise(reach):
        assert start < 0.9 * end
