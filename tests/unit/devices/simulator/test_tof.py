"""The ToF sensor against solutions of its equation, and its spot against distances known by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.machine import ideal_rig
from twinline.devices.simulator.renderer import RoomLight
from twinline.devices.simulator.scenes import Scene, box, mesh_scene, named_scene
from twinline.devices.simulator.tof import FrontEnd, TofFaults, TofReader, TofSensor, full_scale_front_end
from twinline.devices.simulator.tof_beam import SimulatedTofMount
from twinline.devices.simulator.workspace import Workspace
from twinline.devices.simulator.world import Material
from twinline.errors import SettingsError

QUIET = TofSensor(noise_mm=0.0)
EXACT = FrontEnd(counts=1 << 24, noise_counts=0.0)


def distances_mm(reader: TofReader, counts: IntArray) -> FloatArray:
    """Distances that counts stand for: 10 mm a volt, -4 V at 60 mm, gain 0.36 about 1.65 V of 3.3 V."""
    volts = (counts / (reader.front_end.counts - 1) * 3.3 - 1.65) / 0.36
    return np.asarray(60.0 + 10.0 * (volts + 4.0))


def test_a_count_of_the_default_front_end_is_22_micrometres() -> None:
    front = FrontEnd()
    steps = front.count_of(101.0, QUIET) - front.count_of(100.0, QUIET)
    assert 1000.0 / steps == pytest.approx(22.4, abs=0.1)
    assert front.count_of(100.0, QUIET) == pytest.approx(2047.5)


def test_the_full_scale_front_end_spans_the_range_as_capture_folders_state() -> None:
    front = full_scale_front_end(QUIET)
    assert front.count_of(60.0, QUIET) == pytest.approx(0.0, abs=1e-9)
    assert front.count_of(140.0, QUIET) == pytest.approx(4095.0)


def test_the_lag_over_a_slope_a_step_and_a_rest_is_that_of_its_equation() -> None:
    times = np.array([0.0, 0.1, 0.1001, 0.25, 0.4, 0.5])
    true = np.array([100.0, 100.0, 90.0, 90.0, 105.0, 105.0])
    reader = TofReader(QUIET, EXACT)
    grid = np.unique(np.concatenate([np.linspace(0.0, 0.5, 501), times]))
    seen = distances_mm(reader, reader.sample(grid, np.interp(grid, times, true)))
    solved = solve_ivp(
        lambda t, y: (np.interp(t, times, true) - y) / 0.018, (0.0, 0.5), [100.0], t_eval=grid, max_step=2e-4, rtol=1e-8
    )
    np.testing.assert_allclose(seen, solved.y[0], atol=2e-4)


def test_on_a_steady_slope_the_sensor_is_behind_by_speed_times_lag() -> None:
    reader = TofReader(QUIET, EXACT)
    time = np.linspace(0.0, 1.0, 101)
    seen = distances_mm(reader, reader.sample(time, 100.0 + 20.0 * time))
    np.testing.assert_allclose((100.0 + 20.0 * time - seen)[40:], 20.0 * 0.018, atol=1e-4)


@pytest.mark.parametrize("every", [2, 7, 50])
def test_it_does_not_matter_how_often_the_board_looks_while_the_distance_changes_evenly(every: int) -> None:
    time = np.linspace(0.0, 0.35, 351)
    true = 100.0 + 30.0 * time
    often, seldom = TofReader(QUIET, EXACT), TofReader(QUIET, EXACT)
    np.testing.assert_allclose(often.sample(time, true)[::every], seldom.sample(time[::every], true[::every]), atol=2.0)


def test_calls_may_be_cut_anywhere() -> None:
    time = np.linspace(0.0, 0.2, 201)
    true = 100.0 + np.sin(20.0 * time)
    whole, cut = TofReader(seed=4), TofReader(seed=4)
    counts = whole.sample(time, true)
    # Noise is drawn call by call; the sensor's state must not depend on where calls end.
    pieces = np.concatenate([cut.sample(time[a:b], true[a:b]) for a, b in ((0, 1), (1, 90), (90, 201))])
    assert len(pieces) == 201
    assert np.abs(counts - pieces).max() < 12
    quiet_whole, quiet_cut = TofReader(QUIET, EXACT), TofReader(QUIET, EXACT)
    expected = quiet_whole.sample(time, true)
    parts = [quiet_cut.sample(time[a:b], true[a:b]) for a, b in ((0, 1), (1, 90), (90, 201))]
    np.testing.assert_array_equal(np.concatenate(parts), expected)


def test_the_noise_at_rest_has_the_stated_size_and_the_sensor_s_slowness() -> None:
    reader = TofReader(TofSensor(noise_mm=0.02), EXACT, seed=5)
    time = 0.001 * np.arange(200_000)
    noise = distances_mm(reader, reader.sample(time, np.full(time.size, 100.0)))[500:] - 100.0
    assert noise.std() == pytest.approx(0.02, rel=0.08)
    kept = np.corrcoef(noise[:-18], noise[18:])[0, 1]
    assert kept == pytest.approx(np.exp(-1.0), abs=0.06)


def test_the_same_seed_gives_the_same_counts_and_another_seed_others() -> None:
    time, true = 0.001 * np.arange(300), np.full(300, 90.0)
    first = TofReader(seed=1).sample(time, true)
    np.testing.assert_array_equal(TofReader(seed=1).sample(time, true), first)
    assert (TofReader(seed=2).sample(time, true) != first).any()


@pytest.mark.parametrize(("distance", "volts"), [(59.9, -4.4), (140.1, 4.4), (np.inf, 4.4)])
def test_beyond_its_range_the_output_stands_beyond_its_ends(distance: float, volts: float) -> None:
    counts = TofReader(QUIET, FrontEnd(noise_counts=0.0)).sample(np.array([0.0]), np.array([distance]))
    assert counts[0] == round((1.65 + 0.36 * volts) / 3.3 * 4095)
    assert not 260 <= counts[0] <= 3835


def test_after_nothing_was_seen_the_lag_begins_anew() -> None:
    reader = TofReader(QUIET, EXACT)
    time = np.array([0.0, 0.01, 0.02, 0.03])
    seen = distances_mm(reader, reader.sample(time, np.array([80.0, 80.0, np.inf, 120.0])))
    assert seen[3] == pytest.approx(120.0, abs=1e-4)


class TestFaults:
    def test_dropouts_take_their_share_of_the_time_in_pieces(self) -> None:
        reader = TofReader(QUIET, FrontEnd(noise_counts=0.0), seed=3, faults=TofFaults(dropout_share=0.2))
        counts = reader.sample(0.001 * np.arange(60_000), np.full(60_000, 100.0))
        gone = counts > 3835
        assert gone.mean() == pytest.approx(0.2, abs=0.04)
        # A piece is 30 ms, and neighbours may follow each other.
        assert np.diff(np.flatnonzero(np.diff(gone.astype(int)))).min() >= 29

    def test_a_saturated_and_an_unplugged_sensor_stand_still(self) -> None:
        reader = TofReader(QUIET, FrontEnd(noise_counts=0.0))
        reader.faults = TofFaults(saturated=True)
        assert reader.sample(np.array([0.0]), np.array([100.0]))[0] < 260
        reader.faults = TofFaults(unplugged=True)
        assert reader.sample(np.array([0.1]), np.array([100.0]))[0] == 0
        reader.faults = TofFaults()
        assert 2000 < reader.sample(np.array([0.2]), np.array([100.0]))[0] < 2100

    def test_impossible_faults_sensors_and_times_are_refused(self) -> None:
        with pytest.raises(SettingsError, match="between 0 and 1"):
            TofFaults(dropout_share=2.0)
        with pytest.raises(SettingsError, match="ascends"):
            TofSensor(range_mm=(140.0, 60.0))
        reader = TofReader()
        reader.sample(np.array([1.0]), np.array([100.0]))
        with pytest.raises(SettingsError, match="back in time"):
            reader.sample(np.array([0.5]), np.array([100.0]))


PLUMB = SimulatedTofMount(place_mm=(-100.0, -90.0, 136.0), tilt_deg=(0.0, 0.0), slide_yaw_deg=0.0)


def workspace_of(scene: Scene, mount: SimulatedTofMount | None = PLUMB) -> Workspace:
    return Workspace(scene, replace(ideal_rig(), tof=mount), RoomLight(), 1)


class TestSpot:
    def test_a_plumb_beam_measures_heights(self) -> None:
        block = box("block", (40.0, 40.0, 25.0), 0.0, 0.0, 0.0, Material())
        here = workspace_of(Scene("block", (block,)))
        assert here.tof_distance_mm(100.0, 90.0) == pytest.approx(111.0)
        assert here.tof_distance_mm(50.0, 90.0) == pytest.approx(136.0)
        # Over the edge of the block half of the spot falls down.
        assert here.tof_distance_mm(120.0, 90.0) == pytest.approx(136.0 - 12.5, abs=4.0)

    def test_a_tilted_beam_meets_the_bed_where_a_line_does(self) -> None:
        mount = SimulatedTofMount(tilt_deg=(2.0, -3.0), spot_radius_mm=0.0)
        a, b = np.radians(2.0), np.radians(-3.0)
        # Down, turned about x and then about y.
        beam = np.array([-np.cos(a) * np.sin(b), np.sin(a), -np.cos(a) * np.cos(b)])
        np.testing.assert_allclose(mount.beam, beam, atol=1e-12)
        expected = mount.place_mm[2] / -beam[2]
        assert workspace_of(Scene("bed", ()), mount).tof_distance_mm(33.0, 10.0) == pytest.approx(expected)

    def test_slide_and_cart_move_the_spot_along_their_own_directions(self) -> None:
        ball = named_scene("sphere").moved(12.0, 31.0)
        mount = SimulatedTofMount(
            place_mm=(-100.0, -90.0, 136.0),
            tilt_deg=(0.0, 0.0),
            slide_yaw_deg=2.0,
            slide_scale=0.99,
            spot_radius_mm=0.0,
        )
        here = workspace_of(ball, mount)
        yaw = np.radians(2.0)
        for x, y in ((12.0, 31.0), (20.0, 25.0)):
            slide = (y + 90.0) / (0.99 * np.cos(yaw))
            cart = x + 100.0 + 0.99 * slide * np.sin(yaw)
            high = 20.0 + np.sqrt(400.0 - (x - 12.0) ** 2 - (y - 31.0) ** 2)
            assert here.tof_distance_mm(cart, slide) == pytest.approx(136.0 - high, abs=0.01)

    def test_the_spot_averages_a_slope_to_its_middle_and_a_ball_to_less_than_its_top(self) -> None:
        ball = named_scene("sphere").moved(0.0, 0.0)
        wide = SimulatedTofMount(
            place_mm=(-100.0, -90.0, 136.0), tilt_deg=(0.0, 0.0), slide_yaw_deg=0.0, spot_radius_mm=2.0
        )
        # Mean fall of a ball of radius R under an even disc of radius r is r^2 / 4 R.
        seen = workspace_of(ball, wide).tof_distance_mm(100.0, 90.0)
        assert seen == pytest.approx(136.0 - 40.0 + 4.0 / (4 * 20.0), abs=0.006)

    def test_many_positions_at_once_give_the_same_as_one_by_one(self) -> None:
        here = workspace_of(named_scene("three-objects"))
        cart, slide = np.linspace(80.0, 120.0, 9), np.linspace(40.0, 130.0, 9)
        one_by_one = [here.tof_distance_mm(c, s) for c, s in zip(cart, slide, strict=True)]
        np.testing.assert_array_equal(here.tof_distances_mm(cart, slide), one_by_one)

    def test_a_machine_without_a_sensor_says_so(self) -> None:
        with pytest.raises(SettingsError, match="no ToF sensor"):
            workspace_of(Scene("bed", ()), None).tof_distance_mm(0.0, 0.0)


def test_the_board_s_converter_gives_counts_of_the_true_distance() -> None:
    here = workspace_of(mesh_scene("block", box("b", (60.0, 60.0, 30.0), 0.0, 0.0, 0.0, Material()).mesh))
    adc = here.tof_adc(QUIET, FrontEnd(noise_counts=0.0))
    counts = adc(np.full(5, 100.0), np.full(5, 90.0), 1000.0 + 0.001 * np.arange(5))
    np.testing.assert_array_equal(counts, np.full(5, round(FrontEnd().count_of(106.0, QUIET))))
