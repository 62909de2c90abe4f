"""Which places of a scan are compared: patches that both sensors saw in several cells."""

from dataclasses import replace

import numpy as np

from twinline.bench.scanner import Problem, simulated_problem
from twinline.calibration.joint_patches import associate
from twinline.calibration.joint_types import KINDS, Association


def rows(link: Association, kind: str) -> int:
    return int((link.kind == KINDS.index(kind)).sum())


def thinned(problem: Problem, every: int) -> Association:
    """The true scanner's comparisons when only some of the ToF readings are left."""
    tof = problem.observations.tof_objects
    assert tof is not None
    few = tof.take(np.arange(0, len(tof), every))
    return associate(problem.true, replace(problem.observations, tof_objects=few), problem.cell_mm)


def test_a_dense_scan_is_compared_patch_by_patch_and_a_patch_counts_once() -> None:
    problem = simulated_problem(12_000)
    link = associate(problem.true, problem.observations, problem.cell_mm)
    # The scene is some 90 x 160 mm, a patch 12 x 12 mm of one slope.
    assert 50 < rows(link, "laser 1 against laser 2") < 250
    assert rows(link, "laser 1 against ToF") > 20


def test_where_readings_are_few_smaller_patches_count_too() -> None:
    problem = simulated_problem(12_000)
    assert rows(thinned(problem, 12), "laser 1 against ToF") >= 12


def test_without_readings_nothing_is_compared_with_them() -> None:
    problem = simulated_problem(12_000)
    link = associate(problem.true, replace(problem.observations, tof_objects=None), problem.cell_mm)
    assert rows(link, "laser 1 against ToF") == 0
    assert rows(link, "laser 1 against laser 2") > 50
