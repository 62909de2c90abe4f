"""A byte stream over whatever pyserial can open: a tty, ``socket://host:port``, ``rfc2217://host:port``."""

import asyncio
import contextlib
import queue
import threading
from typing import Any

from twinline.devices.serial.streams import Chunk, Connect
from twinline.errors import LinkError

_READ_TIMEOUT_S = 0.1
_WRITE_TIMEOUT_S = 1.0
_JOIN_TIMEOUT_S = 2.0


def port(url: str, baud: int = 115200) -> Connect:
    """A way to open a port.

    Parameters
    ----------
    url
        What pyserial's ``serial_for_url`` takes: a device such as ``/dev/ttyACM0`` or ``COM3``, or a URL.
    baud
        Bit rate, where the port has one; 8 data bits, no parity, 1 stop bit.
    """

    async def connect() -> PortStream:
        opening = asyncio.ensure_future(asyncio.to_thread(_open, url, baud))
        try:
            device = await asyncio.shield(opening)
        except asyncio.CancelledError:
            # The thread goes on; what it opens must not stay open.
            opening.add_done_callback(_close_unwanted)
            raise
        return PortStream(device, url)

    return connect


class PortStream:
    """An open port, read and written in two threads.

    Parameters
    ----------
    device
        A pyserial port.
    name
        What messages call it.
    """

    def __init__(self, device: Any, name: str) -> None:
        self._device = device
        self._name = name
        self._loop = asyncio.get_running_loop()
        self._arrived: asyncio.Queue[Chunk | None] = asyncio.Queue()
        self._waiting: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._closing = False
        self._why = ""
        self._threads = [
            threading.Thread(target=self._read_on, name=f"read {name}", daemon=True),
            threading.Thread(target=self._write_on, name=f"write {name}", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    async def read(self) -> Chunk:
        """Wait for the next bytes; see `ByteStream`."""
        chunk = await self._arrived.get()
        if chunk is None:
            self._arrived.put_nowait(None)
            raise LinkError(f"The connection to {self._name} is lost{self._why}. Check cable and power.")
        return chunk

    def write(self, data: bytes) -> None:
        """Hand bytes over for sending; see `ByteStream`."""
        self._waiting.put(data)

    async def close(self) -> None:
        """Send what is waiting and close the port; see `ByteStream`."""
        self._waiting.put(None)
        await asyncio.shield(asyncio.ensure_future(asyncio.to_thread(self._close)))

    def _close(self) -> None:
        reader, writer = self._threads
        writer.join(_JOIN_TIMEOUT_S)
        self._closing = True
        reader.join(_JOIN_TIMEOUT_S)
        _shut(self._device)

    def _read_on(self) -> None:
        try:
            while not self._closing:
                data = self._device.read(max(1, self._device.in_waiting))
                if data:
                    self._hand_over(Chunk(data, self._loop.time()))
        except Exception as error:  # noqa: BLE001  (pyserial lets OSError, TypeError and termios.error escape)
            self._why = f" ({error})"
        self._hand_over(None)

    def _write_on(self) -> None:
        try:
            while (data := self._waiting.get()) is not None:
                self._device.write(data)
        except Exception as error:  # noqa: BLE001
            self._why = f" ({error})"
            self._hand_over(None)

    def _hand_over(self, chunk: Chunk | None) -> None:
        # The loop may be gone already when the last bytes come.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._arrived.put_nowait, chunk)


def _open(url: str, baud: int) -> Any:
    import serial

    device = None
    try:
        device = serial.serial_for_url(
            url,
            do_not_open=True,
            baudrate=baud,
            timeout=_READ_TIMEOUT_S,
            write_timeout=_WRITE_TIMEOUT_S,
            exclusive=True,
        )
        device.open()
        return device
    except (OSError, ValueError) as error:
        if device is not None:
            _shut(device)
        # pyserial's own error is an OSError too.
        raise LinkError(
            f"There is no connection to a board at {url}: {error}. Check the name, cable and power."
        ) from None


def _close_unwanted(opening: "asyncio.Future[Any]") -> None:
    if not opening.cancelled() and opening.exception() is None:
        _shut(opening.result())


def _shut(device: Any) -> None:
    # pyserial forgets to close a socket whose other end is gone.
    socket = getattr(device, "_socket", None)
    with contextlib.suppress(OSError):
        device.close()
    if socket is not None:
        socket.close()
