"""Each fault in the middle of a scan ends in a defined state, dark and still, or with the pass completed."""

import pytest

from tests.integration.report_faults import FILE, table
from tests.integration.scan_bench import TOF
from tests.integration.scan_faults import FAULTS, LASER_PASS, MOST_DARK_MS, TOF_PASS, Fault, Outcome, fill_disk, outcome
from twinline.devices.board import DEFAULT_CART
from twinline.operations.passes.leg import MOST_SILENCE_S

NAMES = [f"{fault.name}, {fault.during}" for fault in FAULTS]
ROWS = 5


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> list[Outcome]:
    """How a scan with each fault ends; virtual time makes that quick and the same each time."""
    return [outcome(fault, tmp_path_factory.mktemp("fault") / "scan") for fault in FAULTS]


@pytest.fixture(params=range(len(FAULTS)), ids=NAMES)
def case(request: pytest.FixtureRequest, outcomes: list[Outcome]) -> tuple[Fault, Outcome]:
    return FAULTS[request.param], outcomes[request.param]


def test_in_the_end_nothing_shines_and_nothing_moves(case: tuple[Fault, Outcome]) -> None:
    _, seen = case
    assert seen.dark
    assert seen.still


def test_it_ends_as_it_should(case: tuple[Fault, Outcome]) -> None:
    fault, seen = case
    assert (seen.code, seen.legs) == (fault.code, fault.legs)


def test_the_user_reads_sentences_where_anything_is_wrong(case: tuple[Fault, Outcome]) -> None:
    fault, seen = case
    assert bool(seen.reads) == bool(fault.code or fault.noticed)
    assert not seen.reads or seen.reads.endswith(".")


def test_what_was_recorded_opens_again(case: tuple[Fault, Outcome]) -> None:
    assert case[1].readable


def test_the_light_goes_off_in_time(case: tuple[Fault, Outcome]) -> None:
    fault, seen = case
    if fault.during == LASER_PASS and (seen.code or seen.legs > 1) and fault.inject is not fill_disk:
        assert seen.dark_after_ms is not None
        by_camera = "camera" in fault.name or "frame" in fault.name
        assert seen.dark_after_ms <= (MOST_SILENCE_S * 1000.0 if by_camera else MOST_DARK_MS)


def test_a_completed_pass_lacks_nothing_but_what_was_lost_on_its_way(case: tuple[Fault, Outcome]) -> None:
    fault, seen = case
    if seen.code:
        return
    if fault.during == TOF_PASS:
        assert seen.rows == ROWS == len(TOF.row_places_mm(DEFAULT_CART))
    else:
        assert seen.gap_frames <= (2.05 if "lost" in fault.name else 1.05)
        assert seen.overlap_frames <= 1.0


def test_the_table_of_faults_is_up_to_date(outcomes: list[Outcome]) -> None:
    assert table(outcomes) in FILE.read_text(encoding="utf-8"), "run python -m tests.integration.report_faults"
