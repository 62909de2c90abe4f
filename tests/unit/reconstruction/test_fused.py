"""Laser pass and ToF pass together: which sources take part, and what is said where one cannot."""

import json
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.unit.reconstruction.small_pass import Pass, write_pass
from twinline.arrays import FloatArray
from twinline.errors import CalibrationError, CaptureError, RigError
from twinline.fusion.cloud import PointCloud, Source
from twinline.reconstruction.fused import reconstruct_fused, sources_of
from twinline.reconstruction.offline import reconstruct
from twinline.reconstruction.result import ReconstructionOptions
from twinline.recording.capture import Capture, open_capture

TOP_MM = 15.0
TOF_HEIGHT_MM = 100.0
LAG_S, STEP_S, SPEED_MM_S = 0.018, 0.01, 20.0


@pytest.fixture(scope="module")
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = write_pass(tmp_path_factory.mktemp("fused") / "capture", Pass().with_frames(48, 2.0))
    write_tof(folder)
    return open_capture(folder)


@pytest.fixture(scope="module")
def lasers_only(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return open_capture(write_pass(tmp_path_factory.mktemp("lasers") / "capture", Pass().with_frames(24, 2.0)))


def write_tof(folder: Path, raised_mm: float = 0.0) -> None:
    """A raster over the block at positions x = cart, y = slide, with the sensor's lag."""
    rng = np.random.default_rng(11)
    lines, now, lagged = ["time_s,cart_mm,slide_mm,distance_mm"], 0.0, TOF_HEIGHT_MM
    a = float(np.exp(-STEP_S / LAG_S))
    for number, cart in enumerate(np.arange(-30.0, 30.5, 1.5)):
        path = np.arange(-50.0, 50.0, SPEED_MM_S * STEP_S)
        for slide in path[:: -1 if number % 2 else 1]:
            on_block = abs(cart) < 20.0 and -40.0 < slide < 30.0
            true = TOF_HEIGHT_MM - (TOP_MM if on_block else 0.0) - raised_mm
            lagged = true + (lagged - true) * a
            lines.append(f"{now:.3f},{cart:.3f},{slide:.3f},{lagged + rng.normal(0.0, 0.01):.5f}")
            now += STEP_S
    (folder / "tof").mkdir()
    (folder / "tof" / "samples.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    description = json.loads((folder / "capture.json").read_text(encoding="utf-8"))
    description["tof"] = {"range_mm": [60, 140], "mount_mm": [0.0, 0.0, TOF_HEIGHT_MM]}
    (folder / "capture.json").write_text(json.dumps(description), encoding="utf-8")


def distance(points: FloatArray) -> FloatArray:
    """To the block's faces or the bed."""
    low, high = np.array([-20.0, -40.0, 0.0]), np.array([20.0, 30.0, TOP_MM])
    beyond = np.maximum(low - points, points - high)
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return np.asarray(np.minimum(np.abs(outside + np.minimum(beyond.max(axis=1), 0.0)), np.abs(points[:, 2])))


def rms(cloud: PointCloud) -> float:
    near = (np.abs(cloud.points_mm[:, 0]) < 28.0) & (np.abs(cloud.points_mm[:, 1]) < 48.0)
    return float(np.sqrt(np.mean(np.minimum(distance(cloud.points_mm[near].astype(np.float64)), 5.0) ** 2)))


def test_all_there_is_is_used_and_each_point_knows_its_source(capture: Capture, threads: Executor) -> None:
    rig = capture.rig()
    assert sources_of(capture, rig) == {"laser1", "laser2", "tof"}
    result = reconstruct_fused(capture, rig, executor=threads)
    assert {1, 2, 3, 4} <= set(np.unique(result.cloud.source)) <= {1, 2, 3, 4, 5}
    for name, source in (("laser1", 1), ("both lasers", 3), ("tof", 4)):
        assert result.counts[name] == (result.cloud.source == source).sum()
    assert np.isfinite(result.cloud.points_mm).all()
    assert (result.cloud.sigma_mm > 0).all()
    assert result.agreement is not None
    assert abs(result.agreement.offset_mm) < 0.03
    assert result.holes is not None


def test_fused_it_is_nearer_to_the_truth_than_as_measured(capture: Capture, threads: Executor) -> None:
    rig = capture.rig()
    raw = reconstruct(capture, rig, executor=threads).cloud
    fused = reconstruct_fused(capture, rig, executor=threads).cloud
    assert rms(fused) < 0.8 * rms(raw)


def test_tof_points_lie_where_the_sensor_was_without_its_lag(capture: Capture, threads: Executor) -> None:
    result = reconstruct_fused(capture, capture.rig(), ReconstructionOptions(sources=frozenset({"tof"}), fill=False))
    assert set(np.unique(result.cloud.source)) == {Source.TOF}
    # The nominal rig knows no lag; the raster tells it.
    assert distance(result.cloud.points_mm.astype(np.float64)).max() < 0.3
    assert result.frames == 0


def test_one_laser_alone_is_as_measured_but_for_small_gaps(capture: Capture, threads: Executor) -> None:
    options = ReconstructionOptions(sources=frozenset({"laser2"}), fill=False)
    alone = reconstruct_fused(capture, capture.rig(), options, executor=threads)
    raw = reconstruct(capture, capture.rig(), options, executor=threads)
    np.testing.assert_array_equal(alone.cloud.points_mm, raw.cloud.points_mm)
    assert set(np.unique(alone.cloud.source)) == {2}
    assert alone.agreement is None


def test_live_points_are_handed_out_as_they_are_measured(lasers_only: Capture, threads: Executor) -> None:
    parts: list[PointCloud] = []
    reconstruct_fused(lasers_only, lasers_only.rig(), executor=threads, on_points=parts.append)
    raw = reconstruct(lasers_only, lasers_only.rig(), executor=threads).cloud
    np.testing.assert_array_equal(PointCloud.concatenate(parts).points_mm, raw.points_mm)


def test_the_result_is_the_same_whatever_the_executor(capture: Capture, threads: Executor) -> None:
    one = reconstruct_fused(capture, capture.rig(), executor=threads).cloud
    with ThreadPoolExecutor(1) as other:
        two = reconstruct_fused(capture, capture.rig(), executor=other).cloud
    for name in ("points_mm", "sigma_mm", "source", "colour"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_a_source_that_is_not_there_is_refused_by_name(lasers_only: Capture, capture: Capture) -> None:
    wanted = ReconstructionOptions(sources=frozenset({"laser1", "tof"}))
    with pytest.raises(CaptureError, match="holds no ToF pass"):
        reconstruct_fused(lasers_only, lasers_only.rig(), wanted)
    with pytest.raises(RigError, match="has no ToF sensor"):
        reconstruct_fused(capture, replace(capture.rig(), tof=None), wanted)
    for sources, name in ((frozenset({"laser9"}), "laser9"), (frozenset[str](), "none")):
        with pytest.raises(RigError, match=name):
            reconstruct_fused(capture, capture.rig(), ReconstructionOptions(sources=sources))


def test_a_sensor_that_is_mounted_elsewhere_is_left_out_and_said(capture: Capture, threads: Executor) -> None:
    rig = capture.rig()
    assert rig.tof is not None
    higher = replace(rig, tof=replace(rig.tof, position_mm=rig.tof.position_mm + np.array([0.0, 0.0, 2.0])))
    result = reconstruct_fused(capture, higher, executor=threads)
    assert "tof" not in result.counts
    assert any("calibrate its mount" in warning for warning in result.warnings)


def test_the_thesis_s_alignments_are_there_to_choose_with_their_traces(capture: Capture, threads: Executor) -> None:
    rig = capture.rig()
    assert rig.tof is not None
    beside = replace(rig, tof=replace(rig.tof, position_mm=rig.tof.position_mm + np.array([1.0, -0.7, 0.4])))
    options = ReconstructionOptions(sources=sources_of(capture, rig), alignment="thesis")
    result = reconstruct_fused(capture, beside, options, executor=threads)
    laser, tof = result.alignment.laser_1, result.alignment.tof
    assert laser is not None
    assert tof is not None
    # A flat top with sharp shadows does not tell the shift, so nothing is moved by it.
    assert not laser.determined
    assert any("Laser 1 was not moved" in warning for warning in result.warnings)
    assert len(laser.trace.values) > 3
    # Height is told by the bed; with cells of 2.5 mm the block's edges tell little of the rest.
    assert tof.shift_mm[2] == pytest.approx(-0.4, abs=0.1)
    assert tof.after_mm < tof.before_mm
    assert (np.diff(tof.trace.values) <= 0).all()


def test_one_cloud_cannot_be_aligned(lasers_only: Capture, threads: Executor) -> None:
    options = ReconstructionOptions(sources=frozenset({"laser1"}), alignment="thesis")
    with pytest.raises(CalibrationError, match="add a source"):
        reconstruct_fused(lasers_only, lasers_only.rig(), options, executor=threads)
