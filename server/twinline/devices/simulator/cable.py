"""The cable between the simulated board and the host: its speed, and what goes wrong on it."""

import asyncio
from collections.abc import Callable
from random import Random

from twinline.devices.serial.streams import Chunk
from twinline.devices.simulator.simulated_board import SimulatedBoard
from twinline.errors import LinkError

_BITS_PER_BYTE = 10


class Strand:
    """One direction of a cable: what is sent arrives later, in order, and not always as it was.

    Parameters
    ----------
    deliver
        Takes what arrives.
    corrupt, lose
        Tell the present shares of bytes that change and that vanish.
    random
        Decides which.
    baud
        Bit rate; None where what carries the bytes has its own.
    """

    def __init__(
        self,
        deliver: Callable[[bytes], None],
        *,
        corrupt: Callable[[], float],
        lose: Callable[[], float],
        random: Random,
        baud: int | None,
    ) -> None:
        self._deliver = deliver
        self._corrupt = corrupt
        self._lose = lose
        self._random = random
        self._byte_s = 0.0 if baud is None else _BITS_PER_BYTE / baud
        self._free_s = 0.0
        self._cut = False

    def send(self, data: bytes) -> None:
        """Send bytes, which arrive together."""
        loop = asyncio.get_running_loop()
        self._free_s = max(self._free_s, loop.time()) + len(data) * self._byte_s
        if self._byte_s:
            loop.call_at(self._free_s, self._arrive, data)
        else:
            self._arrive(data)

    def cut(self) -> None:
        """Let nothing arrive any more."""
        self._cut = True

    def _arrive(self, data: bytes) -> None:
        if not self._cut:
            self._deliver(self._spoiled(data))

    def _spoiled(self, data: bytes) -> bytes:
        corrupt, lose = self._corrupt(), self._lose()
        if not corrupt and not lose:
            return data
        random, spoiled = self._random, bytearray()
        for byte in data:
            if lose and random.random() < lose:
                continue
            changes = corrupt and random.random() < corrupt
            spoiled.append(byte ^ random.randrange(1, 256) if changes else byte)
        return bytes(spoiled)


def strands(
    board: SimulatedBoard, to_host: Callable[[bytes], None], *, seed: int, baud: int | None
) -> tuple[Strand, Strand]:
    """Both directions of a cable to a board: towards the board, and towards the host."""
    random = Random(seed)
    towards_board = Strand(
        board.feed,
        corrupt=lambda: board.faults.corrupt_to_board,
        lose=lambda: board.faults.lose_to_board,
        random=random,
        baud=baud,
    )
    towards_host = Strand(
        to_host,
        corrupt=lambda: board.faults.corrupt_to_host,
        lose=lambda: board.faults.lose_to_host,
        random=random,
        baud=baud,
    )
    return towards_board, towards_host


class InProcessCable:
    """Connects the serial driver with a simulated board without leaving the process; its `connect` is a `Connect`.

    It works in virtual time too.

    Parameters
    ----------
    board
        The board.
    seed
        For the faults.
    baud
        Bit rate that it keeps to.
    """

    def __init__(self, board: SimulatedBoard, *, seed: int = 0, baud: int = 115200) -> None:
        self._board = board
        self._seed = seed
        self._baud = baud
        self._stream: InProcessStream | None = None
        board.on_faults(self._faults_changed)

    async def connect(self) -> "InProcessStream":
        """Open a connection.

        Raises
        ------
        LinkError
            The cable is pulled, or in use.
        """
        if self._board.faults.unplugged:
            raise LinkError("There is no connection to the simulated board: its cable is pulled.")
        if self._stream is not None and self._stream.open:
            raise LinkError("There is no connection to the simulated board: another driver has its port open.")
        self._seed += 1
        self._stream = InProcessStream(self._board, self._seed, self._baud)
        return self._stream

    def _faults_changed(self) -> None:
        if self._board.faults.unplugged and self._stream is not None:
            self._stream.lose("its cable is pulled")


class InProcessStream:
    """One connection of an `InProcessCable`; a `ByteStream`."""

    def __init__(self, board: SimulatedBoard, seed: int, baud: int) -> None:
        self._board = board
        self._loop = asyncio.get_running_loop()
        self._arrived: asyncio.Queue[Chunk | None] = asyncio.Queue()
        self._why = "it was closed"
        self.open = True
        self._up, self._down = strands(board, self._take, seed=seed, baud=baud)
        board.attach(self._down.send)

    async def read(self) -> Chunk:
        """Wait for the next bytes; see `ByteStream`."""
        chunk = await self._arrived.get()
        if chunk is None:
            self._arrived.put_nowait(None)
            raise LinkError(f"The connection to the simulated board is lost: {self._why}.")
        return chunk

    def write(self, data: bytes) -> None:
        """Hand bytes over for sending; see `ByteStream`."""
        self._up.send(data)

    def lose(self, why: str) -> None:
        """The connection breaks now, with everything that is on its way."""
        self._why = why
        self.open = False
        self._up.cut()
        self._down.cut()
        self._arrived.put_nowait(None)

    async def close(self) -> None:
        """Close it; what is on its way to the board arrives. See `ByteStream`."""
        self.open = False
        self._down.cut()
        self._arrived.put_nowait(None)

    def _take(self, data: bytes) -> None:
        if data:
            self._arrived.put_nowait(Chunk(data, self._loop.time()))
