"""Each fault of board and cable ends in a defined state."""

import pytest

from tests.integration.board_faults import FAULTS, LASER_PASS, Fault, Outcome, outcome
from tests.integration.report_board_faults import FILE, table
from twinline.devices.serial.protocol_gen import HEARTBEAT_DEFAULT_MS


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    """How every fault ends; virtual time makes that quick and the same each time."""
    return [outcome(fault) for fault in FAULTS]


@pytest.mark.parametrize("number", range(len(FAULTS)), ids=[f"{fault.name}, {fault.during}" for fault in FAULTS])
def test_a_fault_ends_dark_and_still_or_with_the_work_done(number: int, outcomes: list[Outcome]) -> None:
    fault, seen = FAULTS[number], outcomes[number]
    assert seen.again
    if not seen.code:
        return
    assert seen.reads.endswith(".")
    if fault.during == LASER_PASS:
        assert seen.dark_after_ms is not None
        # A heartbeat may come just before the fault; and a board that is not heard is given up a little after it.
        assert seen.dark_after_ms <= HEARTBEAT_DEFAULT_MS + 100
        assert seen.moved_on_mm < 50.0


def expected_codes() -> list[tuple[Fault, str]]:
    codes = [
        "",
        "",
        "disconnected",
        "disconnected",
        "heartbeat",
        "device-timeout",
        "board-restarted",
        "board-restarted",
    ]
    codes += ["e-stop", "", "", "", "limit", "wiring", "home-failed", "home-failed", "home-failed"]
    return list(zip(FAULTS, codes, strict=True))


@pytest.mark.parametrize(("fault", "code"), expected_codes(), ids=[f"{f.name}, {f.during}" for f in FAULTS])
def test_the_user_reads_the_cause(fault: Fault, code: str, outcomes: list[Outcome]) -> None:
    assert outcomes[FAULTS.index(fault)].code == code


def test_the_table_of_faults_is_up_to_date(outcomes: list[Outcome]) -> None:
    assert table(outcomes) in FILE.read_text(encoding="utf-8"), "run python -m tests.integration.report_faults"
