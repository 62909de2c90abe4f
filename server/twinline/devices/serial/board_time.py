"""Host time of what the board tells in its own."""

from collections import deque
from dataclasses import dataclass

from twinline.devices.serial.codec import TIME_WRAP_US

_WINDOW_S = 60.0
_BUCKET_S = 1.0
_DRIFT = 100e-6
"""What a quartz may be off by, as far as is known before it is measured."""
_BITS_PER_BYTE = 10


@dataclass(frozen=True)
class _Exchange:
    """One question for the board's time: extra delay, and the host's less the board's clock at the board's answer."""

    host_time_s: float
    delay_s: float
    offset_s: float


class BoardTime:
    """Unwraps the board's microseconds and translates them into host time.

    Each exchange bounds the offset of the clocks by its own delay, so the fastest are believed: the fastest of each
    second of the last minute, and a straight line through them, since the board's quartz drifts against the
    host's.

    Parameters
    ----------
    baud
        Bit rate of the slowest part of the link; the time that lines spend on it is known and is not delay.

    References
    ----------
    D. L. Mills, RFC 5905, section 10 (clock filter: of several exchanges the one with least delay is the best).
    """

    def __init__(self, baud: int) -> None:
        self._byte_s = _BITS_PER_BYTE / baud
        self._best: deque[_Exchange] = deque()
        self._last_us: int | None = None
        self._rate = 0.0
        self._reference = _Exchange(0.0, 0.0, 0.0)

    def restart(self) -> None:
        """The board has started again, and its clock with it."""
        self._best.clear()
        self._last_us = None

    @property
    def known(self) -> bool:
        """Whether any exchange was seen."""
        return bool(self._best)

    def unwrap_s(self, t_us: int, host_time_s: float) -> float:
        """Board time in seconds since its start, from microseconds modulo 2^32.

        Parameters
        ----------
        t_us
            What the board told.
        host_time_s
            When it came; right to half an hour is enough.
        """
        if self._best:
            guess_us = (host_time_s - self._offset_s(host_time_s)) * 1e6
        else:
            guess_us = float(t_us if self._last_us is None else self._last_us)
        turns = round((guess_us - t_us) / TIME_WRAP_US)
        self._last_us = t_us + max(0, turns) * TIME_WRAP_US
        return self._last_us * 1e-6

    def add(self, t_us: int, sent_s: float, received_s: float, *, sent_bytes: int, received_bytes: int) -> None:
        """Take an exchange: the host asked, and the board answered with its time.

        Parameters
        ----------
        t_us
            The board's time.
        sent_s, received_s
            Host time when the question was handed over, and when the answer had come whole.
        sent_bytes, received_bytes
            Lengths of both lines.
        """
        # Where bytes travel faster than by the bit rate, in USB or TCP, the lines still share the time by length.
        byte_s = min(self._byte_s, (received_s - sent_s) / (sent_bytes + received_bytes))
        arrival_s = sent_s + sent_bytes * byte_s
        answer_s = received_s - received_bytes * byte_s
        board_s = self.unwrap_s(t_us, received_s)
        self._keep(_Exchange(received_s, max(0.0, answer_s - arrival_s), (arrival_s + answer_s) / 2.0 - board_s))

    def host_time_s(self, board_time_s: float) -> float:
        """Host time of a board time in seconds since its start."""
        # The rate is parts per million, so one step of the fixed point is exact to nanoseconds.
        rough_s = board_time_s + self._reference.offset_s
        return board_time_s + self._offset_s(rough_s)

    def _offset_s(self, host_time_s: float) -> float:
        return self._reference.offset_s + self._rate * (host_time_s - self._reference.host_time_s)

    def _keep(self, exchange: _Exchange) -> None:
        if self._best and exchange.host_time_s // _BUCKET_S == self._best[-1].host_time_s // _BUCKET_S:
            if exchange.delay_s >= self._best[-1].delay_s:
                return
            self._best.pop()
        self._best.append(exchange)
        while self._best[0].host_time_s < exchange.host_time_s - _WINDOW_S:
            self._best.popleft()
        self._fit()

    def _fit(self) -> None:
        """Line through the fastest exchanges; as long as there are few, the one with the smallest possible error."""
        fastest = min(exchange.delay_s for exchange in self._best)
        good = [exchange for exchange in self._best if exchange.delay_s <= 2.0 * fastest + 0.0005]
        mean_s = sum(exchange.host_time_s for exchange in good) / len(good)
        mean_offset = sum(exchange.offset_s for exchange in good) / len(good)
        spread = sum((exchange.host_time_s - mean_s) ** 2 for exchange in good)
        span_s = good[-1].host_time_s - good[0].host_time_s
        if len(good) >= 4 and span_s > 8.0 * _BUCKET_S:
            products = ((e.host_time_s - mean_s) * (e.offset_s - mean_offset) for e in good)
            self._rate = sum(products) / spread
            self._reference = _Exchange(mean_s, fastest, mean_offset)
        else:
            newest_s = self._best[-1].host_time_s
            self._rate = 0.0
            self._reference = min(good, key=lambda e: e.delay_s / 2.0 + _DRIFT * (newest_s - e.host_time_s))
