from collections.abc import Iterator

import numpy as np
import pytest
import viser

from tests.unit.operations.fakes import FakeClock, some_points
from twinline.fusion.cloud import PointCloud
from twinline.operations.display import ColourMode
from twinline.view.bridge import ViewBridge
from twinline.view.stage import FIELD_OF_VIEW_RAD, FLUSH_INTERVAL_S, Stage


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    bridge = ViewBridge()
    yield bridge.server
    bridge.close()


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def stage(server: viser.ViserServer, clock: FakeClock) -> Stage:
    return Stage(server, clock, max_points=1000)


def drawn_mm(stage: Stage) -> np.ndarray:
    """All points on the stage, in the bed frame."""
    nodes = [node.handle for node in stage._nodes]
    return np.concatenate([np.asarray(node.points, float) + node.position for node in nodes])


def test_every_batch_becomes_a_node_with_exact_points(stage: Stage, clock: FakeClock) -> None:
    clouds = [some_points(100, seed=number) for number in range(3)]
    stage.begin(job_id="j-1")
    for cloud in clouds:
        clock.elapsed_s += 1.0
        stage.append(cloud)
    assert len(stage._nodes) == 3
    expected = np.concatenate([cloud.points_mm for cloud in clouds])
    np.testing.assert_allclose(drawn_mm(stage), expected, atol=2e-5)
    assert all(node.handle.precision == "float32" for node in stage._nodes)


def test_batches_that_come_faster_than_ten_a_second_are_shown_together(stage: Stage, clock: FakeClock) -> None:
    stage.begin(job_id="j-1")
    for number in range(20):
        stage.append(some_points(10, seed=number))
        clock.elapsed_s += FLUSH_INTERVAL_S / 5
    assert len(stage._nodes) == 4
    assert stage.state().shown < 200
    stage.finish(scan_id="s-1")
    assert stage.state().shown == 200
    assert (stage.state().points, stage.state().scan_id, stage.state().job_id) == (200, "s-1", "j-1")


def test_beyond_the_limit_the_cloud_is_thinned_evenly_and_says_so(stage: Stage, clock: FakeClock) -> None:
    stage.begin()
    for number in range(10):
        clock.elapsed_s += 1.0
        stage.append(some_points(400, seed=number))
    stage.finish()
    state = stage.state()
    assert state.points == 4000
    assert 400 <= state.shown <= 1000
    assert state.note is not None
    assert "point is drawn" in state.note
    x = drawn_mm(stage)[:, 0]
    assert abs(np.median(x) - 50.0) < 10.0


def test_a_whole_cloud_larger_than_the_limit_is_thinned(stage: Stage) -> None:
    stage.begin()
    stage.append(some_points(5000))
    stage.finish()
    assert stage.state().shown <= 1000


def test_beginning_again_clears_the_stage(stage: Stage, server: viser.ViserServer) -> None:
    stage.begin()
    stage.append(some_points(50))
    stage.begin(job_id="j-2")
    assert (stage.state().points, stage.state().shown, stage.state().job_id) == (0, 0, "j-2")
    stage.clear()
    assert stage.state().job_id is None


def test_points_that_are_not_numbers_are_not_drawn(stage: Stage) -> None:
    cloud = some_points(50)
    cloud.points_mm[7] = np.nan
    stage.begin()
    stage.append(cloud)
    stage.append(PointCloud.empty())
    stage.finish()
    assert (stage.state().points, stage.state().shown) == (50, 49)
    assert np.isfinite(drawn_mm(stage)).all()


@pytest.mark.parametrize("mode", list(ColourMode))
def test_every_colour_mode_recolours_what_is_shown(stage: Stage, mode: ColourMode) -> None:
    stage.begin()
    stage.append(some_points(50))
    before = np.array(stage._nodes[0].handle.colors)
    stage.set_colour(mode)
    after = np.array(stage._nodes[0].handle.colors)
    assert stage.state().colour is mode
    assert (stage.state().legend is None) == (mode in (ColourMode.SOURCE, ColourMode.COLOUR))
    assert np.array_equal(before, after) == (mode is ColourMode.HEIGHT)


def test_the_colour_scale_follows_a_growing_cloud(stage: Stage, clock: FakeClock) -> None:
    stage.begin()
    stage.append(some_points(100))
    high = some_points(100, seed=1)
    high.points_mm[:, 2] += 100.0
    clock.elapsed_s += 1.0
    stage.append(high)
    legend = stage.state().legend
    assert legend is not None
    assert legend.max > 100.0


def test_a_few_stray_points_do_not_move_the_first_camera(stage: Stage, server: viser.ViserServer) -> None:
    cloud = some_points(900)
    stage.append(cloud)
    stage.finish()
    near_mm = np.linalg.norm(server.initial_camera.position - server.initial_camera.look_at)
    cloud.points_mm[:2] = ((0, -5000, 0), (0, 0, 5000))
    stage.begin()
    stage.append(cloud)
    stage.finish()
    far_mm = np.linalg.norm(server.initial_camera.position - server.initial_camera.look_at)
    assert far_mm == pytest.approx(near_mm, rel=0.05)


def test_the_first_camera_looks_at_the_object_and_not_at_all_of_the_bed(
    stage: Stage, server: viser.ViserServer
) -> None:
    bed, thing = some_points(700), some_points(100, seed=1)
    bed.points_mm[:] *= (6.0, 10.0, 0.01)
    thing.points_mm[:] = thing.points_mm * (0.2, 0.3, 1.0) + (300.0, 200.0, 3.0)
    stage.append(PointCloud.concatenate([bed, thing]))
    stage.finish()
    np.testing.assert_allclose(server.initial_camera.look_at, thing.points_mm.mean(axis=0), atol=3.0)
    assert np.linalg.norm(server.initial_camera.position - server.initial_camera.look_at) < 100.0


def test_the_first_camera_sees_every_corner_of_the_cloud(stage: Stage, server: viser.ViserServer) -> None:
    stage.begin()
    stage.append(some_points(500))
    stage.finish()
    camera = server.initial_camera
    forward = camera.look_at - camera.position
    forward /= np.linalg.norm(forward)
    to_points = drawn_mm(stage) - camera.position
    to_points /= np.linalg.norm(to_points, axis=1)[:, None]
    assert np.arccos(to_points @ forward).max() <= FIELD_OF_VIEW_RAD / 2
    assert camera.position[2] > 0
    assert camera.near < np.linalg.norm(camera.look_at - camera.position) < camera.far
