"""Events in the order of their numbers, each once, from a wire that loses some and repeats others."""

from twinline.devices.serial.codec import WireEvent
from twinline.devices.serial.protocol_gen import EVENTS_KEPT


class EventOrder:
    """Holds back what came too early until the missing ones have come."""

    def __init__(self) -> None:
        self._ahead: dict[int, WireEvent] = {}
        self.expected = 0
        """Number of the first event that has not been given out."""

    @property
    def waiting(self) -> bool:
        """Whether events have come after one that is missing."""
        return bool(self._ahead)

    def begin(self, expected: int) -> None:
        """Begin with a number; nothing that came before counts."""
        self._ahead.clear()
        self.expected = expected

    def take(self, event: WireEvent) -> list[WireEvent]:
        """Take an event as it came, and give those that are next in order."""
        # What is further ahead than the board keeps must be asked for again anyway.
        if self.expected <= event.n < self.expected + EVENTS_KEPT:
            self._ahead[event.n] = event
        return self._in_order()

    def skip_to(self, first: int) -> tuple[list[WireEvent], int]:
        """Give up those that the board no longer keeps.

        Parameters
        ----------
        first
            Number of the oldest that it still has.

        Returns
        -------
        list of WireEvent, int
            Those before it that came all the same, with what follows them, and how many are lost.
        """
        early = [self._ahead.pop(n) for n in range(self.expected, first) if n in self._ahead]
        lost = max(0, first - self.expected) - len(early)
        self.expected = max(self.expected, first)
        return early + self._in_order(), lost

    def _in_order(self) -> list[WireEvent]:
        ready = []
        while (event := self._ahead.pop(self.expected, None)) is not None:
            self.expected += 1
            ready.append(event)
        return ready
