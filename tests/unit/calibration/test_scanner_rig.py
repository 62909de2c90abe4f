import numpy as np

from tests.unit.calibration.scanner_samples import crooked_rig
from twinline.calibration.scanner import scanner_of_rig
from twinline.calibration.scanner_rig import make_rig, rig_covariance
from twinline.geometry.rig_json import rig_from_json, rig_to_json
from twinline.geometry.triangulation import point_covariance, stripe_points


def small_covariance(size: int, scale: np.ndarray, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    mix = rng.normal(size=(size, size)) / np.sqrt(size)
    return np.asarray((mix @ mix.T) * np.outer(scale, scale))


def test_a_scanner_becomes_a_rig_with_the_same_points_and_back() -> None:
    base = crooked_rig()
    scanner = scanner_of_rig(base)
    rig = make_rig(base, scanner, np.zeros((len(scanner.vector()),) * 2), {"sheets": "given"}, None)
    pixels = np.array([[100.0, 480.0], [900.0, 470.0]])
    sd = np.full(2, 0.1)
    for laser in (0, 1):
        expected, _ = stripe_points(base, laser, pixels, sd, 33.0)
        found, _ = stripe_points(rig, laser, pixels, sd, 33.0)
        np.testing.assert_allclose(found, expected, atol=1e-9)
    assert rig.travel[1] == 0.0 or abs(rig.travel[1]) < 1e-12
    assert rig.sources == {"sheets": "given"}


def test_the_covariance_predicts_how_points_scatter() -> None:
    base = crooked_rig()
    scanner = scanner_of_rig(base)
    theta = scanner.vector()
    scale = np.abs(theta) * 2e-5 + 1e-8
    scale[8] = 0.0
    covariance = small_covariance(len(theta), scale)
    rig = make_rig(base, scanner, covariance, {}, None)
    pixels = np.array([[200.0, 470.0], [1000.0, 500.0]])
    predicted = point_covariance(rig, 0, pixels, 120.0)
    rng = np.random.default_rng(4)
    root = np.linalg.cholesky(covariance + np.diag(np.where(scale > 0, 0, 1e-40)))
    points = []
    for _ in range(1500):
        other = scanner.with_vector(theta + root @ rng.normal(size=len(theta)))
        moved = make_rig(base, other, covariance, {}, None)
        points.append(stripe_points(moved, 0, pixels, np.zeros(2), 120.0)[0])
    for i in range(2):
        seen = np.cov(np.array(points)[:, i].T)
        np.testing.assert_allclose(np.sqrt(np.diagonal(seen)), np.sqrt(np.diagonal(predicted[i])), rtol=0.08)


def test_names_are_those_a_rig_file_knows_and_exact_parameters_are_left_out() -> None:
    base = crooked_rig()
    scanner = scanner_of_rig(base)
    theta = scanner.vector()
    scale = np.abs(theta) * 1e-5 + 1e-9
    scale[8] = 0.0
    covariance = rig_covariance(scanner, small_covariance(len(theta), scale))
    assert "camera.k3" not in covariance.names
    assert {"sheet1.a", "sheet2.c", "bed.rx", "bed.z", "travel.x", "tof.gain", "tof.lag"} <= set(covariance.names)
    # The frame's own choices carry no uncertainty.
    assert not {"bed.x", "bed.y", "travel.y"} & set(covariance.names) or covariance.sd("travel.y") < 1e-9
    rig = make_rig(base, scanner, small_covariance(len(theta), scale), {}, None)
    again = rig_from_json(rig_to_json(rig))
    assert again.covariance is not None
    assert again.covariance.names == rig.covariance.names if rig.covariance else False
