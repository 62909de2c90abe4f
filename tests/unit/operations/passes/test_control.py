"""Pausing, resuming and cancelling a movement."""

import asyncio

import pytest

from twinline.devices.virtual_time import run_virtual
from twinline.errors import CancelledError, LinkError, MotionError
from twinline.operations.passes.control import PassControl

STOPPED = MotionError("It was told to stop.", code="stopped")


class Movement:
    """Takes ten seconds unless it is stopped."""

    def __init__(self) -> None:
        self._stop = asyncio.Event()

    async def run(self) -> None:
        try:
            async with asyncio.timeout(10.0):
                await self._stop.wait()
        except TimeoutError:
            return
        raise MotionError(STOPPED.detail, code=STOPPED.code)

    async def stop(self) -> None:
        self._stop.set()


def test_a_pause_stops_what_moves_and_explains_its_end() -> None:
    async def play() -> tuple[bool, bool]:
        control, movement = PassControl(), Movement()
        moving = asyncio.ensure_future(control.drive(movement.run(), movement.stop))
        await asyncio.sleep(1.0)
        control.pause()
        control.resume()
        with pytest.raises(MotionError):
            await moving
        explained = control.explains(STOPPED)
        await control.checkpoint()
        return explained, control.explains(STOPPED)

    assert run_virtual(play()) == (True, False)


def test_a_stop_by_somebody_else_or_another_error_is_not_explained() -> None:
    control = PassControl()
    assert not control.explains(STOPPED)
    control.pause()
    assert not control.explains(LinkError("The cable is pulled."))


def test_nothing_begins_to_move_while_paused() -> None:
    async def play() -> None:
        control, movement = PassControl(), Movement()
        control.pause()
        with pytest.raises(MotionError, match="paused or cancelled"):
            await control.drive(movement.run(), movement.stop)

    run_virtual(play())


def test_a_checkpoint_waits_for_the_end_of_a_pause() -> None:
    async def play() -> float:
        control, loop = PassControl(), asyncio.get_running_loop()
        begin_s = loop.time()
        control.pause()
        loop.call_later(5.0, control.resume)
        await control.checkpoint()
        return loop.time() - begin_s

    assert run_virtual(play()) == pytest.approx(5.0)


def test_a_cancellation_ends_a_pause_too() -> None:
    async def play() -> None:
        control = PassControl()
        control.pause()
        asyncio.get_running_loop().call_later(5.0, control.cancel)
        await control.checkpoint()

    with pytest.raises(CancelledError, match="recorded until then is kept"):
        run_virtual(play())


def test_a_link_that_is_down_does_not_hinder_a_pause() -> None:
    async def play() -> bool:
        control, movement = PassControl(), Movement()

        async def stop() -> None:
            raise LinkError("The cable is pulled.")

        moving = asyncio.ensure_future(control.drive(movement.run(), stop))
        await asyncio.sleep(1.0)
        control.pause()
        await moving
        return control.paused

    assert run_virtual(play())
