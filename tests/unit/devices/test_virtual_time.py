"""Time that jumps."""

import asyncio
import threading

import pytest

from twinline.devices.virtual_time import START_S, VirtualTimeLoop, hold, run_virtual


def test_hours_pass_at_once_and_in_order() -> None:
    async def main() -> list[float]:
        loop, seen = asyncio.get_running_loop(), []

        async def at(delay_s: float) -> None:
            await asyncio.sleep(delay_s)
            seen.append(loop.time() - START_S)

        await asyncio.gather(at(7200.0), at(0.25), at(3600.0))
        return seen

    assert run_virtual(main()) == pytest.approx([0.25, 3600.0, 7200.0])


def test_time_stands_still_while_a_thread_works() -> None:
    released = threading.Event()

    async def main() -> float:
        loop = asyncio.get_running_loop()
        ticked = False

        async def tick() -> None:
            nonlocal ticked
            await asyncio.sleep(1.0)
            ticked = True

        ticking = asyncio.create_task(tick())
        before = loop.time()
        loop.call_soon(loop.call_soon, released.set)
        with hold():
            await asyncio.to_thread(released.wait)
        assert loop.time() == before
        assert not ticked
        await ticking
        return loop.time() - before

    assert run_virtual(main()) == pytest.approx(1.0)


def test_without_holding_time_runs_on() -> None:
    released = threading.Event()

    async def main() -> float:
        loop = asyncio.get_running_loop()
        before = loop.time()
        loop.call_later(5.0, released.set)
        await asyncio.to_thread(released.wait)
        return loop.time() - before

    assert run_virtual(main()) >= 5.0


def test_holding_means_nothing_to_other_loops() -> None:
    async def main() -> bool:
        with hold():
            await asyncio.sleep(0)
        return isinstance(asyncio.get_running_loop(), VirtualTimeLoop)

    assert not asyncio.run(main())


def test_pipes_work_under_virtual_time() -> None:
    async def main() -> bytes:
        arrived: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            arrived.set_result(await reader.readexactly(3))
            writer.close()

        with hold():
            server = await asyncio.start_server(serve, "127.0.0.1", 0)
            _, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
            writer.write(b"abc")
            data = await arrived
            writer.close()
            await writer.wait_closed()
            server.close()
            await server.wait_closed()
        return data

    assert run_virtual(main()) == b"abc"
