"""The simulated board behind a pseudo-terminal or a TCP port, for the driver as it is and for other programs."""

import asyncio
import contextlib
import os
import sys
from pathlib import Path

from twinline.devices.simulator.cable import Strand, strands
from twinline.devices.simulator.simulated_board import SimulatedBoard
from twinline.errors import DeviceError

_PIECE = 65536


class PtyPort:
    """A pseudo-terminal that looks like the board's serial port; where the system has such.

    Parameters
    ----------
    board
        The board.
    path
        Where a link to the terminal is to appear, so that its name stays the same when the cable is pulled and
        plugged; without it the name changes.
    seed
        For the faults.
    baud
        Bit rate that it keeps to; None for as fast as can be.
    """

    def __init__(
        self, board: SimulatedBoard, path: Path | None = None, *, seed: int = 0, baud: int | None = 115200
    ) -> None:
        if sys.platform == "win32":
            raise DeviceError("This system has no pseudo-terminals; use the TCP port of the simulated board.")
        self._board = board
        self._path = path
        self._seed = seed
        self._baud = baud
        self._loop = asyncio.get_running_loop()
        self._ends: tuple[int, int] | None = None
        self._strands: tuple[Strand, Strand] | None = None
        board.on_faults(self._faults_changed)
        self._plug()

    @property
    def url(self) -> str:
        """Name of the port, for pyserial.

        Raises
        ------
        DeviceError
            The cable is pulled.
        """
        if self._ends is None:
            raise DeviceError("The simulated board's cable is pulled, so it has no port.")
        return str(self._path) if self._path else os.ttyname(self._ends[1])

    def close(self) -> None:
        """Take the port away."""
        if self._ends is None or self._strands is None:
            return
        master, slave = self._ends
        self._ends = None
        for strand in self._strands:
            strand.cut()
        self._board.detach()
        self._loop.remove_reader(master)
        os.close(master)
        os.close(slave)
        if self._path:
            self._path.unlink(missing_ok=True)

    def _plug(self) -> None:
        import pty
        import tty

        master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._seed += 1
        self._ends = (master, slave)
        self._strands = strands(self._board, self._to_host, seed=self._seed, baud=self._baud)
        if self._path:
            self._path.unlink(missing_ok=True)
            self._path.symlink_to(os.ttyname(slave))
        self._loop.add_reader(master, self._readable)
        self._board.attach(self._strands[1].send)

    def _faults_changed(self) -> None:
        if self._board.faults.unplugged:
            self.close()
        elif self._ends is None:
            self._plug()

    def _readable(self) -> None:
        if self._ends is not None and self._strands is not None:
            with contextlib.suppress(OSError):
                self._strands[0].send(os.read(self._ends[0], _PIECE))

    def _to_host(self, data: bytes) -> None:
        # With nobody reading, the terminal's buffer fills; like a serial line it then loses what comes.
        if self._ends is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._ends[0], data)


class TcpPort:
    """A TCP port on this machine's own address, as serial servers have; one host at a time, the newest.

    Parameters
    ----------
    board
        The board.
    seed
        For the faults.
    baud
        Bit rate that it keeps to; None for as fast as can be.
    """

    def __init__(self, board: SimulatedBoard, *, seed: int = 0, baud: int | None = 115200) -> None:
        self._board = board
        self._seed = seed
        self._baud = baud
        self._number = 0
        self._server: asyncio.Server | None = None
        self._writer: asyncio.StreamWriter | None = None
        board.on_faults(self._faults_changed)

    @property
    def url(self) -> str:
        """Address, for pyserial."""
        return f"socket://127.0.0.1:{self._number}"

    async def open(self) -> None:
        """Listen."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self._number = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Disconnect, and listen no more."""
        self._drop()
        if self._server is not None:
            self._server.close()
            self._server = None
        # What was dropped is closed by the loop in its next turn.
        await asyncio.sleep(0)
        await asyncio.sleep(0)

    def _drop(self) -> None:
        if self._writer is not None:
            self._writer.transport.abort()
            self._writer = None
        self._board.detach()

    def _faults_changed(self) -> None:
        # It goes on listening: a port that is given up may be somebody else's when the cable is plugged again.
        if self._board.faults.unplugged:
            self._drop()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._board.faults.unplugged or self._server is None:
            writer.transport.abort()
            return
        if self._writer is not None:
            self._writer.transport.abort()
        self._writer = writer
        self._seed += 1
        up, down = strands(self._board, writer.write, seed=self._seed, baud=self._baud)
        self._board.attach(down.send)
        with contextlib.suppress(OSError):
            while data := await reader.read(_PIECE):
                up.send(data)
        down.cut()
        if self._writer is writer:
            self._writer = None
            self._board.detach()
        writer.close()
