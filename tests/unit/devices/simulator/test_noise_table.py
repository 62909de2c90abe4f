"""The cheap normal numbers are normal."""

import numpy as np

from twinline.devices.simulator.noise_table import frame_seeds, normal_pool, normal_table


def test_the_table_has_the_moments_of_the_normal_distribution() -> None:
    table = normal_table().astype(np.float64)
    np.testing.assert_allclose([table.mean(), table.std(), (table**3).mean()], [0.0, 1.0, 0.0], atol=1e-5)
    assert abs((table**4).mean() - 3.0) < 0.05
    np.testing.assert_allclose(np.quantile(table, [0.1587, 0.9772]), [-1.0, 2.0], atol=0.01)


def test_frames_have_seeds_of_their_own() -> None:
    seeds = {int(s) for frame in range(50) for s in frame_seeds(7, frame, 3)}
    assert len(seeds) == 150
    assert 0 not in seeds
    np.testing.assert_array_equal(frame_seeds(7, 3, 3), frame_seeds(7, 3, 3))


def test_the_pool_is_normal_and_the_same_for_the_same_seed() -> None:
    pool = normal_pool(1 << 14, 3)
    np.testing.assert_allclose([pool.mean(), pool.std()], [0.0, 1.0], atol=1e-4)
    assert abs((pool.astype(np.float64) ** 4).mean() - 3.0) < 0.2
    np.testing.assert_array_equal(normal_pool(1 << 14, 3), pool)
    assert (normal_pool(1 << 14, 4) != pool).any()
