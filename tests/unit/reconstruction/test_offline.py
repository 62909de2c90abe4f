"""A whole pass, from pictures to points: true to the scene, and the same however the work is divided."""

import os
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twinline.reconstruction.offline as offline
from tests.unit.reconstruction.small_pass import BED_RGB, BLOCK_RGB, NO_BLOCK, Pass, write_pass
from twinline.errors import CancelledError, StripeError, WorkerError
from twinline.fusion.cloud import PointCloud, Source
from twinline.reconstruction.offline import IN_FLIGHT_PER_CORE, reconstruct
from twinline.reconstruction.result import Reconstruction, ReconstructionOptions
from twinline.recording.capture import Capture, open_capture
from twinline.recording.images import read_image

TOP_MM = 15.0


@pytest.fixture(scope="module")
def threads() -> Executor:
    return ThreadPoolExecutor(1)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return open_capture(write_pass(tmp_path_factory.mktemp("pass") / "capture"))


@pytest.fixture(scope="module")
def result(capture: Capture, threads: Executor) -> Reconstruction:
    return reconstruct(capture, capture.rig(), executor=threads)


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return open_capture(write_pass(tmp_path_factory.mktemp("short") / "capture", Pass().with_frames(24, 4.0)))


def on_top(cloud: PointCloud) -> Any:
    """Points well inside the block's upper face."""
    x, y, z = cloud.points_mm.T
    return (np.abs(x) < 17) & (y > -36) & (y < 26) & (z > 0.5 * TOP_MM)


def on_bed(cloud: PointCloud) -> Any:
    """Points well clear of the block."""
    x, y, _ = cloud.points_mm.T
    return (np.abs(x) > 26) | (y < -45) | (y > 35)


def require_same(one: PointCloud, other: PointCloud, *, colour: bool = True) -> None:
    for name in ("points_mm", "sigma_mm", "intensity", "source", *(["colour"] if colour else [])):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


class TestTruth:
    def test_the_block_s_top_and_the_bed_have_their_heights(self, result: Reconstruction) -> None:
        cloud = result.cloud
        top, bed = cloud.points_mm[on_top(cloud), 2], cloud.points_mm[on_bed(cloud), 2]
        assert len(top) > 1500
        assert len(bed) > 15_000
        # One pixel is 2.4 mm of height here; the stripe's noise of 0.02 px is 0.05 mm.
        assert float(np.mean(top)) == pytest.approx(TOP_MM, abs=0.02)
        assert float(np.mean(bed)) == pytest.approx(0.0, abs=0.02)
        assert max(float(top.std()), float(bed.std())) < 0.1

    def test_the_block_lies_where_it_is(self, result: Reconstruction) -> None:
        high = result.cloud.points_mm[result.cloud.points_mm[:, 2] > TOP_MM - 1.0]
        # Frames are 1.5 mm apart along x and pixels 1.4 mm wide along y; points at the very edge are dropped.
        np.testing.assert_allclose(high.min(axis=0)[:2], [-20.0, -40.0], atol=5.0)
        np.testing.assert_allclose(high.max(axis=0)[:2], [20.0, 30.0], atol=5.0)
        assert (high.min(axis=0)[:2] > [-20.7, -40.7]).all()
        assert (high.max(axis=0)[:2] < [20.7, 30.7]).all()

    def test_both_lasers_see_it_alike_and_are_told_apart(self, result: Reconstruction) -> None:
        cloud = result.cloud
        for source in (Source.LASER_1, Source.LASER_2):
            own = cloud.select((cloud.source == source) & on_top(cloud))
            assert len(own) > 700
            assert float(own.points_mm[:, 2].mean()) == pytest.approx(TOP_MM, abs=0.03)
        assert result.counts["laser1"] + result.counts["laser2"] == len(cloud)
        assert set(np.unique(cloud.source)) == {1, 2}

    def test_points_carry_the_surface_s_own_colour_not_the_laser_s(self, result: Reconstruction) -> None:
        cloud = result.cloud
        known = (cloud.colour != 128).any(axis=1)
        for where, colour in ((on_top(cloud), BLOCK_RGB), (on_bed(cloud), BED_RGB)):
            assert (where & known).sum() > 500
            np.testing.assert_allclose(np.median(cloud.colour[where & known], axis=0), colour, atol=1.5)
        assert np.percentile(cloud.colour[known, 0], 99) < 90

    def test_reported_deviations_match_the_scatter(self, result: Reconstruction) -> None:
        cloud = result.cloud
        bed = on_bed(cloud)
        scatter = float(cloud.points_mm[bed, 2].std())
        assert float(np.median(cloud.sigma_mm[bed])) == pytest.approx(scatter, rel=0.35)

    def test_nothing_of_the_scene_is_left_out(self, result: Reconstruction) -> None:
        assert result.frames == result.frames_used == 81
        assert result.problem_count == 0
        assert len(result.cloud) > 0.9 * 81 * 2 * 160


class TestDivision:
    def test_any_executor_gives_the_same_bits(self, short: Capture, threads: Executor) -> None:
        one = reconstruct(short, short.rig(), executor=threads).cloud
        with ThreadPoolExecutor(3) as pool:
            require_same(one, reconstruct(short, short.rig(), executor=pool).cloud)
        with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
            require_same(one, reconstruct(short, short.rig(), executor=pool).cloud)

    @pytest.mark.parametrize("size", [1, 5, 24])
    def test_any_size_of_share_gives_the_same_points(
        self, size: int, short: Capture, threads: Executor, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        usual = reconstruct(short, short.rig(), executor=threads).cloud
        monkeypatch.setattr(offline, "chunk_frames", lambda plan, frames: size)
        # Colours come from other frames of the share, so a share of one frame has none.
        require_same(usual, reconstruct(short, short.rig(), executor=threads).cloud, colour=False)

    def test_points_are_handed_out_in_order_and_are_the_result(self, short: Capture, threads: Executor) -> None:
        parts: list[PointCloud] = []
        callers = set()

        def on_points(cloud: PointCloud) -> None:
            parts.append(cloud)
            callers.add(threading.current_thread())

        whole = reconstruct(short, short.rig(), executor=threads, on_points=on_points).cloud
        require_same(PointCloud.concatenate(parts), whole)
        assert callers == {threading.current_thread()}

    def test_progress_rises_to_the_number_of_frames(self, short: Capture, threads: Executor) -> None:
        told: list[tuple[int, int]] = []
        reconstruct(short, short.rig(), executor=threads, report=lambda done, total: told.append((done, total)))
        assert told[0] == (0, 24)
        assert told[-1] == (24, 24)
        assert told == sorted(told)

    def test_a_checkpoint_can_end_it(self, short: Capture, threads: Executor, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(offline, "chunk_frames", lambda plan, frames: 4)
        seen: list[int] = []

        def stop() -> None:
            if seen:
                raise CancelledError("stopped")

        with pytest.raises(CancelledError):
            reconstruct(short, short.rig(), executor=threads, checkpoint=stop, on_points=lambda c: seen.append(len(c)))
        assert len(seen) == 1

    def test_the_number_of_shares_under_way_is_bounded(self, short: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(offline, "chunk_frames", lambda plan, frames: 1)
        monkeypatch.setattr(os, "cpu_count", lambda: 2)
        lazy = LazyExecutor()
        reconstruct(short, short.rig(), executor=lazy)
        assert lazy.submitted == 24
        assert lazy.most_waiting <= 2 * IN_FLIGHT_PER_CORE

    def test_a_worker_that_dies_is_reported_as_such(self, short: Capture) -> None:
        with pytest.raises(WorkerError, match="worker process died"):
            reconstruct(short, short.rig(), executor=DyingExecutor())


class LazyExecutor(Executor):
    """Works only when somebody asks for a result, so that what waits can be counted."""

    def __init__(self) -> None:
        self.submitted = self.waiting = self.most_waiting = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.submitted += 1
        self.waiting += 1
        self.most_waiting = max(self.most_waiting, self.waiting)
        executor = self

        class Later(Future[Any]):
            def result(self, timeout: float | None = None) -> Any:
                executor.waiting -= 1
                return fn(*args, **kwargs)

        return Later()


class DyingExecutor(Executor):
    """A pool whose processes have died."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_exception(BrokenProcessPool("gone"))
        return future


class TestCost:
    @pytest.mark.parametrize("frames", [12, 24])
    def test_each_frame_is_decoded_once_and_a_few_are_sampled_before(
        self, frames: int, tmp_path: Path, threads: Executor, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        capture = open_capture(write_pass(tmp_path / "capture", Pass().with_frames(frames, 96.0 / frames)))
        decoded: list[Path] = []

        def counted(path: Path, *size: tuple[int, int]) -> Any:
            decoded.append(path)
            return read_image(path, *size)

        monkeypatch.setattr("twinline.recording.frames.read_image", counted)
        reconstruct(capture, capture.rig(), executor=threads)
        assert set(decoded) == set((capture.path / "laser").glob("*.png"))
        assert len(decoded) <= frames + 5


class TestChoices:
    def test_every_third_frame_gives_what_a_pass_of_these_frames_gives(
        self, short: Capture, tmp_path: Path, threads: Executor
    ) -> None:
        fewer = Pass().with_frames(24, 4.0)
        thinned = write_pass(tmp_path / "capture", replace(fewer, cart_mm=fewer.cart_mm[::3], seed=99))
        for place, name in enumerate(f"{i:04d}.png" for i in range(8)):
            (thinned / "laser" / name).write_bytes((short.path / "laser" / f"{3 * place:04d}.png").read_bytes())
        other = open_capture(thinned)
        third = reconstruct(short, short.rig(), ReconstructionOptions(every=3), executor=threads)
        require_same(third.cloud, reconstruct(other, other.rig(), executor=threads).cloud)
        assert third.frames == 8

    @pytest.mark.parametrize("laser", [1, 2])
    def test_one_source_gives_only_that_laser_s_points(self, laser: int, short: Capture, threads: Executor) -> None:
        both = reconstruct(short, short.rig(), executor=threads).cloud
        options = ReconstructionOptions(sources=frozenset({f"laser{laser}"}))
        alone = reconstruct(short, short.rig(), options, executor=threads).cloud
        assert set(np.unique(alone.source)) == {laser}
        assert len(alone) == pytest.approx(int((both.source == laser).sum()), rel=0.04)

    @pytest.mark.parametrize("place", [2, 3])
    def test_one_grey_frame_among_colour_frames_is_counted_and_the_rest_is_kept(
        self, place: int, tmp_path: Path, threads: Executor
    ) -> None:
        # The frame at place 2 is among those that are looked at before the first; the one at place 3 is not.
        capture = open_capture(
            write_pass(
                tmp_path / "capture",
                Pass().with_frames(24, 4.0),
                change=lambda at, picture: np.ascontiguousarray(picture[..., 2]) if at == place else picture,
            )
        )
        result = reconstruct(capture, capture.rig(), executor=threads)
        assert [problem.frame for problem in result.problems] == [f"{place:04d}.png"]
        assert "one channel" in result.problems[0].reason
        assert result.frames_used == 23

    def test_a_pass_without_any_stripe_is_refused(self, tmp_path: Path, threads: Executor) -> None:
        dark = replace(Pass().with_frames(4), laser_dn=0.0, block=NO_BLOCK)
        capture = open_capture(write_pass(tmp_path / "capture", dark))
        with pytest.raises(StripeError, match="None of the 4 frames"):
            reconstruct(capture, capture.rig(), executor=threads)

    def test_grey_pictures_give_the_same_heights(self, tmp_path: Path, threads: Executor) -> None:
        capture = open_capture(write_pass(tmp_path / "capture", replace(Pass().with_frames(24, 4.0), colour=False)))
        cloud = reconstruct(capture, capture.rig(), executor=threads).cloud
        assert float(np.median(cloud.points_mm[on_top(cloud), 2])) == pytest.approx(TOP_MM, abs=0.1)
        assert (cloud.colour == 128).all()

    def test_alternating_lasers_give_both_lasers_points(self, tmp_path: Path, threads: Executor) -> None:
        given = Pass().with_frames(48, 2.0)
        turns = tuple(frozenset({1 + place % 2}) for place in range(48))
        capture = open_capture(write_pass(tmp_path / "capture", replace(given, lit=turns)))
        result = reconstruct(capture, capture.rig(), executor=threads)
        assert result.problem_count == 0
        cloud = result.cloud
        for source in (1, 2):
            top = cloud.points_mm[on_top(cloud) & (cloud.source == source), 2]
            assert len(top) > 100
            assert float(np.median(top)) == pytest.approx(TOP_MM, abs=0.1)
