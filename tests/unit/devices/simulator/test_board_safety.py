"""The simulated board's lasers in any state that requests, faults and time can bring about."""

import asyncio
from itertools import count

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twinline.devices.serial.codec import Answer, BadRequest, Request, WireEvent, parse_message, parse_request
from twinline.devices.serial.framing import LineReader, Noise, framed
from twinline.devices.serial.protocol_gen import ErrorCode, EventKind, Flag, Latch
from twinline.devices.simulator.faults import Faults
from twinline.devices.simulator.machine_state import MachineState
from twinline.devices.simulator.simulated_board import SimulatedBoard
from twinline.devices.virtual_time import run_virtual

LIT = Flag.LASER_1 | Flag.LASER_2
REQUESTS = st.sampled_from(
    [
        "HELLO", "STATUS", "HB 500", "HB 200", "HB 0", "LASER 0", "LASER 1", "LASER 3", "STOP", "RESET", "HOME 0",
        "HOME 1",
        "MOVE 0 100", "MOVE 0 -50", "MOVE 1 2000", "MOVE 1 -5000", "SCAN 0 100 500000 3 0", "SCAN 50 0 200000 12 20000",
        "SCAN 0 100 500000 120 20000", "RASTER 0 20 10 0 1000 4000000", "TELEM 100 1", "TELEM 0 1",
    ]
)  # fmt: skip
FAULTS = st.sampled_from(
    [Faults(), Faults(e_stop=True), Faults(low_switch=True), Faults(low_switch=True, high_switch=True)]
)
STEPS = st.lists(
    st.tuples(st.one_of(REQUESTS, FAULTS, st.sampled_from(["reset", "hang"])), st.sampled_from([0.0, 0.01, 0.12, 0.7])),
    max_size=25,
)


class Wire:
    """A host that writes lines and looks at the answers."""

    def __init__(self, board: SimulatedBoard) -> None:
        self._board = board
        self._reader = LineReader()
        self._numbers = count(1)
        self.answers: list[Answer] = []
        self.events: list[WireEvent] = []
        board.attach(self._take)

    def ask(self, text: str, *, number: int | None = None) -> Answer:
        """Send a request and give its answer."""
        before = len(self.answers)
        self._board.feed(framed(f"#{next(self._numbers) if number is None else number} {text}"))
        return self.answers[before]

    def flags(self) -> Flag:
        """The board's own view of its state."""
        return Flag(int(self.ask("STATUS").words[4]))

    def _take(self, data: bytes) -> None:
        for line in self._reader.feed(data):
            assert not isinstance(line, Noise)
            message = parse_message(line)
            if isinstance(message, Answer):
                self.answers.append(message)
            elif isinstance(message, WireEvent):
                self.events.append(message)


@settings(max_examples=150)
@given(STEPS)
def test_light_needs_a_heartbeat_and_no_latch_whatever_happens(steps: list[tuple[object, float]]) -> None:
    async def main() -> None:
        board = SimulatedBoard()
        wire = Wire(board)
        wire.ask("HELLO")
        for step, pause_s in steps:
            hung = step == "hang"
            if isinstance(step, Faults):
                board.faults = step
            elif step == "reset":
                board.reset()
            elif hung:
                board.hang()
            else:
                board.feed(framed(f"#{len(wire.answers) + 1000} {step}"))
            # A program that hangs can do nothing; its watchdog can.
            await asyncio.sleep(max(pause_s, 0.13) if hung else max(pause_s, 0.03) if step == "reset" else pause_s)
            shining = board.lasers(asyncio.get_running_loop().time())
            flags = wire.flags()
            if shining:
                assert Flag.HEARTBEAT in flags
                assert Flag.LATCHED not in flags
                assert flags & LIT
            if board.faults.e_stop:
                assert not shining
        await asyncio.sleep(0.55)
        assert not board.lasers(asyncio.get_running_loop().time())
        await asyncio.sleep(60.0)
        assert not board.moving
        board.close()

    run_virtual(main())


def test_light_goes_with_the_heartbeat_at_its_deadline() -> None:
    async def main() -> None:
        board = SimulatedBoard()
        wire, loop = Wire(board), asyncio.get_running_loop()
        wire.ask("HELLO")
        assert wire.ask("LASER 3").words == (ErrorCode.NO_HEARTBEAT.value,)
        wire.ask("HB 500")
        assert wire.ask("LASER 3").ok
        await asyncio.sleep(0.499)
        assert board.lasers(loop.time()) == {1, 2}
        await asyncio.sleep(0.002)
        assert board.lasers(loop.time()) == frozenset()
        assert [event.a for event in wire.events if event.kind is EventKind.LATCH] == [Latch.HEARTBEAT]
        wire.ask("HB 500")
        assert wire.ask("LASER 3").words == (ErrorCode.LATCHED.value,)
        wire.ask("RESET")
        assert wire.ask("LASER 3").ok
        board.close()

    run_virtual(main())


def test_a_pass_without_heartbeat_is_refused_and_one_that_loses_it_goes_dark() -> None:
    async def main() -> None:
        board = SimulatedBoard()
        wire, loop = Wire(board), asyncio.get_running_loop()
        wire.ask("HELLO")
        wire.ask("HOME 0")
        assert wire.ask("SCAN 0 1000 500000 3 0").words == (ErrorCode.NO_HEARTBEAT.value,)
        wire.ask("HB 2000")
        assert wire.ask("SCAN 0 1000 500000 3 0").ok
        # Disarmed before the light was due, the pass must not switch it on later.
        wire.ask("HB 0")
        for _ in range(40):
            await asyncio.sleep(0.1)
            assert not board.lasers(loop.time())
        board.close()

    run_virtual(main())


def test_the_same_command_again_is_answered_the_same_and_not_done_again() -> None:
    async def main() -> None:
        board = SimulatedBoard()
        wire = Wire(board)
        wire.ask("HELLO")
        first = wire.ask("MOVE 0 10", number=77)
        assert wire.ask("MOVE 0 10", number=77) == first
        await asyncio.sleep(1.0)
        assert wire.ask("MOVE 0 10", number=77) == first
        await asyncio.sleep(1.0)
        assert [event.kind for event in wire.events].count(EventKind.MOTION_END) == 1
        # Another command with an old number is another command.
        assert wire.ask("MOVE 0 20", number=77) != first
        await asyncio.sleep(1.0)
        assert board.counts()[0] == 20
        # And a new session forgets.
        wire.ask("HELLO")
        assert wire.ask("MOVE 0 20", number=77).words != first.words
        board.close()

    run_virtual(main())


def test_a_new_session_is_dark_and_brakes() -> None:
    async def main() -> None:
        board = SimulatedBoard()
        wire = Wire(board)
        wire.ask("HELLO")
        wire.ask("HB 2000")
        wire.ask("LASER 3")
        wire.ask("MOVE 0 1000")
        await asyncio.sleep(0.5)
        wire.ask("HELLO")
        assert not board.lasers(asyncio.get_running_loop().time())
        await asyncio.sleep(0.5)
        assert not board.moving
        board.close()

    run_virtual(main())


@pytest.mark.parametrize("text", ["MOVE 0 10", "LASER 3", "HB 500", "SCAN 0 10 500000 3 0", "RESET", "TELEM 10 1"])
def test_before_hello_nothing_is_done(text: str) -> None:
    async def main() -> None:
        board = SimulatedBoard()
        assert Wire(board).ask(text).words == (ErrorCode.NO_SESSION.value,)
        board.close()

    run_virtual(main())


def test_40_emergency_stops_at_any_phase_leave_exact_counts() -> None:
    async def main() -> None:
        board = SimulatedBoard()
        state: MachineState = board
        wire, loop = Wire(board), asyncio.get_running_loop()
        wire.ask("HELLO")
        for number in range(40):
            start_mm = state.cart_mm(loop.time())
            wire.ask("HOME 0")
            wire.ask("MOVE 0 900")
            await asyncio.sleep(0.0371 * (number + 1) % 1.3 + 0.0001 * number)
            board.faults = Faults(e_stop=True)
            counted = board.counts()[0]
            end = wire.events[-2] if wire.events[-1].kind is EventKind.LATCH else wire.events[-1]
            assert (end.kind, end.cart) == (EventKind.MOTION_END, counted)
            assert not wire.flags() & (Flag.CART_KNOWN | Flag.SLIDE_KNOWN)
            await asyncio.sleep(0.2)
            assert board.counts()[0] == counted
            assert state.cart_mm(loop.time()) - start_mm == pytest.approx(counted * 0.10053)
            board.faults = Faults()
            assert wire.ask("RESET").ok
        board.close()

    run_virtual(main())


def test_the_strategy_holds_requests_of_the_protocol_only() -> None:
    for text in REQUESTS.elements:  # type: ignore[attr-defined]
        assert isinstance(parse_request(f"#1 {text}"), Request)
        assert not isinstance(parse_request(f"#1 {text}"), BadRequest)
