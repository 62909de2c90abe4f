"""What a connection to a board is: bytes both ways, until it is lost."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias


@dataclass(frozen=True)
class Chunk:
    """Bytes that arrived together.

    Attributes
    ----------
    data
        The bytes, at least one.
    host_time_s
        When the last of them arrived, in host time.
    """

    data: bytes
    host_time_s: float


class ByteStream(Protocol):
    """An open connection."""

    async def read(self) -> Chunk:
        """Wait for the next bytes.

        Raises
        ------
        LinkError
            The connection is lost, or was closed here.
        """
        ...

    def write(self, data: bytes) -> None:
        """Hand bytes over for sending, without waiting; on a lost connection they are lost too."""
        ...

    async def close(self) -> None:
        """Send what was handed over, if that is possible soon, and disconnect; never raises, may be called again."""
        ...


Connect: TypeAlias = Callable[[], Awaitable[ByteStream]]
"""Opens a connection each time it is called; raises LinkError where there is none to be had."""
