"""The adjustment that is timed is a real one: it starts wrong, ends right, and has the promised size."""

import numpy as np
import pytest

from twinline.arrays import FloatArray
from twinline.bench.calibration import JOINT, SIMPLEX, joint_adjustment
from twinline.bench.figures import Section
from twinline.bench.scanner import simulated_problem
from twinline.calibration.joint_patches import associate
from twinline.calibration.joint_rows import evaluate


@pytest.fixture(scope="module")
def section() -> Section:
    return joint_adjustment(rounds=2, observations=12_000, evaluations=400)


def test_the_problem_has_thirty_parameters_and_the_observations_asked_for() -> None:
    problem = simulated_problem(12_000)
    assert problem.free.sum() == 30
    assert 12_000 <= problem.count < 12_500


def test_the_true_scanner_explains_the_observations_and_the_start_does_not() -> None:
    problem = simulated_problem(12_000)

    def typical_mm(theta: FloatArray) -> float:
        scanner = problem.true.with_vector(theta)
        link = associate(scanner, problem.observations, problem.cell_mm)
        return float(np.median(np.abs(evaluate(scanner, problem.observations, link).residual)))

    assert typical_mm(problem.true.vector()) < 0.015
    assert typical_mm(problem.start.vector()) > 0.1


def test_the_joint_adjustment_ends_right_where_as_bounded_a_search_does_not(section: Section) -> None:
    before = section.figure("shape error before").value.median
    joint = section.figure(f"shape error after the {JOINT}").value.median
    simplex = section.figure(f"shape error after {SIMPLEX}").value.median
    assert before > 0.2
    assert joint < 0.03
    assert joint < simplex <= before


def test_its_time_is_held_against_one_second_and_the_search_against_it(section: Section) -> None:
    promised = section.figure(JOINT).ratios[0]
    assert (promised.against, promised.must, promised.aim) == ("1 s", 1.0, 0.2)
    assert promised.value == section.figure(JOINT).value
    assert section.figure(SIMPLEX).ratios[0].against == JOINT
