"""A program that opens the board at a port, switches the lasers on, says so and waits to be ended."""

import asyncio
import sys

from twinline.devices.serial.driver import SerialBoard
from twinline.devices.serial.port import port
from twinline.devices.termination import cancelled_by_sigterm


async def shine(url: str, *, careless: bool) -> None:
    board = SerialBoard(port(url))
    with cancelled_by_sigterm():
        await board.open()
        try:
            await board.lasers(frozenset({1, 2}))
            sys.stdout.write("on\n")
            sys.stdout.flush()
            await asyncio.sleep(3600.0)
        finally:
            # If nobody closes the board, the end of the event loop has to.
            if not careless:
                await board.close()


if __name__ == "__main__":
    asyncio.run(shine(sys.argv[1], careless=sys.argv[2:] == ["careless"]))
