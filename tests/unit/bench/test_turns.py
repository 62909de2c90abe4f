"""Measuring in turns: order, caches, and what comes of the times. No test looks at how long anything takes."""

import os

import numpy as np
import pytest

from twinline.bench.figures import Quartiles
from twinline.bench.turns import compare, one_core, take_turns


def test_subjects_are_called_in_turns_after_a_warm_up() -> None:
    calls: list[str] = []
    times = take_turns({"a": lambda _: calls.append("a"), "b": lambda _: calls.append("b")}, 4)
    measured = calls[-8:]
    assert measured == ["a", "b"] * 4
    assert calls[0] == "a"
    assert len(calls) > len(measured)
    assert {name: len(of) for name, of in times.items()} == {"a": 4, "b": 4}
    assert all((of > 0).all() for of in times.values())


def test_what_prepares_the_caches_goes_before_every_measured_call() -> None:
    calls: list[str] = []
    take_turns({"a": lambda _: calls.append("a")}, 3, before=lambda: calls.append("read"))
    assert calls[-6:] == ["read", "a"] * 3


def test_every_subject_is_told_the_number_of_the_round() -> None:
    rounds: list[int] = []
    take_turns({"a": rounds.append}, 5)
    assert rounds[-5:] == [0, 1, 2, 3, 4]


def test_a_ratio_is_taken_round_by_round_and_not_of_the_medians() -> None:
    times = {"slow": np.array([20.0, 2.0, 30.0]), "quick": np.array([1.0, 2.0, 10.0])}
    ratio = compare(times, "slow", "quick", must=4.0, aim=2.0)
    assert ratio.against == "quick"
    assert ratio.value == Quartiles.of(np.array([20.0, 1.0, 3.0]))
    assert ratio.value.median == 3.0
    assert ratio.verdict == "meets the must"


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system cannot hold a process to a core")
def test_one_core_means_one_core_and_is_given_back() -> None:
    before = os.sched_getaffinity(0)
    with one_core():
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before
