"""What every board must do, to be inherited by a test class for each kind of board; no class may take a test away."""

import asyncio
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from itertools import pairwise

import pytest

from twinline.devices.board import AXES, Board, BoardEvent, BoardMessage, LaserPass, LinkChange, Telemetry, TofRaster
from twinline.devices.serial.protocol_gen import EventKind, Flag
from twinline.errors import LinkError, MotionError, RefusedError, TwinlineError

BOTH = frozenset({1, 2})
DARK: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Bench:
    """A board that is not open yet, and a look at its machine.

    Attributes
    ----------
    board
        The board.
    shining
        Which lasers truly shine now.
    cart_mm
        Where the cart truly is now.
    moving
        Whether anything moves now.
    """

    board: Board
    shining: Callable[[], frozenset[int]]
    cart_mm: Callable[[], float]
    moving: Callable[[], bool]


class BoardContract:
    """The guarantees of `twinline.devices.board.Board`."""

    @pytest.fixture
    def bench(self) -> Bench:
        """For each kind of board to give."""
        raise NotImplementedError

    @pytest.fixture
    async def board(self, bench: Bench) -> AsyncIterator[Board]:
        """The board, open."""
        await bench.board.open()
        yield bench.board
        await bench.board.close()

    @pytest.fixture
    async def homed(self, board: Board) -> Board:
        """The board, open, with known positions."""
        for axis in AXES:
            await board.home(axis)
        return board

    async def test_it_tells_what_it_is(self, bench: Bench) -> None:
        info = await bench.board.open()
        assert info.name
        assert info.lasers == BOTH
        assert set(info.drives) == set(AXES)
        assert await bench.board.open() == info
        await bench.board.close()

    async def test_it_can_be_closed_twice_and_opened_again(self, bench: Bench) -> None:
        for _ in range(2):
            await bench.board.open()
            await bench.board.status()
            await bench.board.close()
            await bench.board.close()

    async def test_before_opening_and_after_closing_commands_fail_at_once(self, bench: Bench) -> None:
        board = bench.board
        for _ in range(2):
            for command in (board.status, board.stop, board.reset, lambda: board.move("cart", 1.0, 5.0)):
                with pytest.raises(LinkError):
                    await command()
            await board.open()
            await board.close()

    async def test_a_movement_ends_at_the_nearest_step(self, bench: Bench, board: Board) -> None:
        start_mm = (await board.status()).cart_mm
        await board.move("cart", start_mm + 1.03, 20.0)
        status = await board.status()
        assert status.cart_mm == pytest.approx(start_mm + 1.0053, abs=1e-9)
        assert bench.cart_mm() == pytest.approx(start_mm + 1.0053, abs=0.01)
        assert not bench.moving()

    async def test_a_movement_to_where_it_stands_is_complete(self, board: Board) -> None:
        await board.move("cart", (await board.status()).cart_mm, 20.0)

    async def test_both_axes_move_at_once(self, board: Board) -> None:
        before = await board.status()
        await asyncio.gather(board.move("cart", 2.0, 20.0), board.move("slide", before.slide_mm + 2.0, 10.0))
        after = await board.status()
        assert after.slide_mm == pytest.approx(before.slide_mm + 2.0, abs=0.003)
        assert after.cart_mm == pytest.approx(2.0, abs=0.06)

    async def test_what_is_out_of_range_is_refused_and_nothing_moves(self, bench: Bench, homed: Board) -> None:
        low_mm = -101.0
        for command in (
            lambda: homed.move("cart", low_mm, 10.0),
            lambda: homed.move("cart", 5.0, 0.0),
            lambda: homed.move("cart", 5.0, 1e6),
            lambda: homed.laser_pass(LaserPass(low_mm, 0.0, 20.0)),
            lambda: homed.laser_pass(LaserPass(0.0, 10.0, 20.0, (DARK, BOTH), 0.04)),
            lambda: homed.raster(TofRaster(0.0, 2.0, 1.0, 0.0, 500.0, 20.0)),
            lambda: homed.lasers(frozenset({3})),
        ):
            with pytest.raises(RefusedError) as refusal:
                await command()
            assert refusal.value.code == "out-of-range"
        assert not bench.moving()
        assert bench.shining() == DARK

    async def test_lasers_go_on_one_by_one_and_off_on_closing(self, bench: Bench, board: Board) -> None:
        for on in (frozenset({1}), frozenset({2}), BOTH):
            await board.lasers(on)
            assert bench.shining() == on
            assert (await board.status()).lasers == on
        await board.close()
        assert bench.shining() == DARK

    async def test_lasers_stay_on_while_the_heartbeat_goes(self, bench: Bench, board: Board) -> None:
        await board.lasers(BOTH)
        await asyncio.sleep(1.2)
        assert bench.shining() == BOTH
        assert not (await board.status()).latch

    async def test_stopping_ends_everything_and_says_so(self, bench: Bench, board: Board) -> None:
        await board.lasers(BOTH)
        moving = asyncio.create_task(board.move("cart", 90.0, 20.0))
        await asyncio.sleep(0.2)
        assert bench.moving()
        await board.stop()
        assert bench.shining() == DARK
        with pytest.raises(MotionError) as end:
            await moving
        assert end.value.code == "stopped"
        assert not bench.moving()
        assert 0.0 < bench.cart_mm() < 30.0

    async def test_cancelling_who_waits_for_a_movement_brakes_it(self, bench: Bench, board: Board) -> None:
        await board.lasers(BOTH)
        moving = asyncio.create_task(board.move("cart", 90.0, 20.0))
        await asyncio.sleep(0.2)
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await moving
        assert bench.shining() == DARK
        await asyncio.sleep(0.3)
        assert not bench.moving()

    async def test_an_axis_takes_one_movement_at_a_time(self, board: Board) -> None:
        moving = asyncio.create_task(board.move("cart", 8.0, 20.0))
        await asyncio.sleep(0.1)
        with pytest.raises(RefusedError) as refusal:
            await board.move("cart", 0.0, 20.0)
        assert refusal.value.code == "busy"
        await moving

    async def test_homing_makes_positions_known(self, board: Board) -> None:
        known = Flag.CART_KNOWN | Flag.SLIDE_KNOWN
        assert not (await board.status()).flags & known
        for axis in AXES:
            await board.home(axis)
        status = await board.status()
        assert known in status.flags
        assert status.cart_mm == 0.0
        assert 0.0 <= status.slide_mm <= 5.0

    async def test_a_pass_needs_known_positions(self, bench: Bench, board: Board) -> None:
        for command in (
            lambda: board.laser_pass(LaserPass(5.0, 10.0, 20.0)),
            lambda: board.raster(TofRaster(0.0, 2.0, 1.0, 2.0, 4.0, 20.0)),
        ):
            with pytest.raises(RefusedError) as refusal:
                await command()
            assert refusal.value.code == "not-homed"
        assert bench.shining() == DARK

    async def test_a_laser_pass_shines_over_its_range_only(self, bench: Bench, homed: Board) -> None:
        await homed.telemetry(100)
        messages = homed.subscribe()
        await homed.laser_pass(LaserPass(5.0, 15.0, 20.0))
        assert bench.shining() == DARK
        await homed.close()
        seen = [message async for message in messages]
        events = [message for message in seen if isinstance(message, BoardEvent)]
        kinds = [event.kind for event in events]
        assert kinds.index(EventKind.SCAN_START) < kinds.index(EventKind.SCAN_END) < kinds.index(EventKind.MOTION_END)
        start, end = (next(e for e in events if e.kind is kind) for kind in (EventKind.SCAN_START, EventKind.SCAN_END))
        assert [start.cart_mm, end.cart_mm] == pytest.approx([5.0, 15.0], abs=0.06)
        speed = (end.cart_mm - start.cart_mm) / (end.board_time_s - start.board_time_s)
        assert speed == pytest.approx(20.0, rel=1e-3)
        samples = [message for message in seen if isinstance(message, Telemetry)]
        lit = [sample for sample in samples if sample.lasers]
        assert {sample.lasers for sample in lit} == {BOTH}
        assert all(start.cart_mm - 0.06 <= sample.cart_mm <= end.cart_mm + 0.06 for sample in lit)
        assert len(lit) == pytest.approx(50, abs=2)

    async def test_lasers_take_turns_in_a_pass(self, homed: Board) -> None:
        await homed.telemetry(200)
        messages = homed.subscribe()
        phases = (frozenset({1}), frozenset({2}), DARK)
        await homed.laser_pass(LaserPass(5.0, 15.0, 20.0, phases, 0.05))
        await homed.close()
        seen = [message async for message in messages]
        events = {message.kind: message for message in seen if isinstance(message, BoardEvent)}
        begin_s, end_s = events[EventKind.SCAN_START].board_time_s, events[EventKind.SCAN_END].board_time_s
        for sample in (message for message in seen if isinstance(message, Telemetry)):
            since_s = sample.board_time_s - begin_s
            in_range = begin_s <= sample.board_time_s < end_s
            if 0.001 < since_s % 0.05 < 0.049:
                assert sample.lasers == (phases[int(since_s / 0.05) % 3] if in_range else DARK)

    async def test_a_raster_sweeps_to_and_fro_over_its_rows(self, bench: Bench, homed: Board) -> None:
        messages = homed.subscribe()
        await homed.raster(TofRaster(1.0, 3.0, 1.0, 2.0, 6.0, 20.0))
        await homed.close()
        rows = [m async for m in messages if isinstance(m, BoardEvent) and m.kind.value.startswith("row")]
        assert [(event.kind.value, event.b) for event in rows] == [
            (f"row-{end}", row) for row in range(3) for end in ("start", "end")
        ]
        assert [round(event.slide_mm, 2) for event in rows] == [2, 6, 6, 2, 2, 6]
        assert [event.cart_mm for event in rows[::2]] == pytest.approx([1.0, 2.0, 3.0], abs=0.06)
        assert not bench.moving()

    async def test_telemetry_comes_at_its_rate_and_stops(self, board: Board) -> None:
        messages = board.subscribe()
        await board.telemetry(50)
        await asyncio.sleep(0.5)
        await board.telemetry(0)
        await asyncio.sleep(0.1)
        await board.telemetry(50, samples=4)
        await asyncio.sleep(0.3)
        await board.close()
        samples = [message async for message in messages if isinstance(message, Telemetry)]
        single = [sample for sample in samples if not sample.earlier_adc]
        fourfold = [sample for sample in samples if len(sample.earlier_adc) == 3]
        assert len(single) + len(fourfold) == len(samples)
        for part in (single, fourfold):
            assert len(part) > 10
            assert all(after.n == before.n + 1 for before, after in pairwise(part))
            assert all(
                after.board_time_s - before.board_time_s == pytest.approx(0.02, abs=1e-5)
                for before, after in pairwise(part)
            )
        assert all(after.host_time_s > before.host_time_s for before, after in pairwise(samples))

    async def test_a_subscription_hears_everything_and_ends_with_the_board(self, board: Board) -> None:
        first, second = board.subscribe(), board.subscribe()
        await board.move("cart", 1.0, 20.0)
        await board.close()

        async def heard(messages: AsyncIterator[BoardMessage]) -> list[BoardMessage]:
            return [message async for message in messages]

        one, other = await heard(first), await heard(second)
        assert one == other
        assert isinstance(one[-1], LinkChange)
        assert one[-1].state == "closed"
        events = [message for message in one if isinstance(message, BoardEvent)]
        assert EventKind.MOTION_END in [event.kind for event in events]
        assert all(after.n == before.n + 1 for before, after in pairwise(events))

    async def test_closing_gives_up_what_moves(self, bench: Bench, board: Board) -> None:
        moving = asyncio.create_task(board.move("cart", 90.0, 20.0))
        await asyncio.sleep(0.2)
        await board.close()
        with pytest.raises(TwinlineError):
            await moving
        await asyncio.sleep(0.5)
        assert not bench.moving()
        assert bench.shining() == DARK
