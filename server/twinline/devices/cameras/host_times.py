"""When a frame was exposed, from when it arrived and what the camera's clock said."""

from collections import deque

# Long enough to hold a frame that was not held up, short enough for a clock that is 100 ppm off: 0.5 ms.
_WINDOW_S = 5.0
_SMALLEST_STEP_S = 1e-6


class HostTimes:
    """Turns arrivals into times of mid-exposure.

    Frames arrive late by different amounts and never early. Where the camera stamps its frames, the smallest
    difference between arrival and stamp within the last seconds is the offset of the two clocks, and the stamps' own
    regularity remains (the minimum filter of D. Mills, Network Time Protocol, RFC 5905, section 10).

    Parameters
    ----------
    latency_s
        Time from the end of the exposure to the arrival of a frame that is not held up.
    """

    def __init__(self, latency_s: float) -> None:
        self._latency_s = latency_s
        # Arrivals and differences; the differences ascend, so that the first is the smallest.
        self._differences: deque[tuple[float, float]] = deque()
        self._last_stamp_s = float("-inf")
        self._last_s = float("-inf")

    def mid_exposure_s(self, arrival_s: float, camera_time_s: float | None, exposure_s: float | None) -> float:
        """Host time of the middle of the exposure; greater than that of the frame before."""
        came_s = arrival_s if camera_time_s is None else self._on_time_s(arrival_s, camera_time_s)
        time_s = came_s - self._latency_s - (exposure_s or 0.0) / 2
        self._last_s = max(time_s, self._last_s + _SMALLEST_STEP_S)
        return self._last_s

    def restart(self) -> None:
        """Forget the camera's clock: after a new connection it may have another zero."""
        self._differences.clear()
        self._last_stamp_s = float("-inf")

    def _on_time_s(self, arrival_s: float, camera_time_s: float) -> float:
        """When the frame would have arrived, had nothing held it up."""
        if camera_time_s <= self._last_stamp_s:
            # The camera has set its clock or started again; or the stamp says nothing, and the arrival counts.
            self.restart()
        self._last_stamp_s = camera_time_s
        difference_s = arrival_s - camera_time_s
        while self._differences and self._differences[0][0] < arrival_s - _WINDOW_S:
            self._differences.popleft()
        while self._differences and self._differences[-1][1] >= difference_s:
            self._differences.pop()
        self._differences.append((arrival_s, difference_s))
        return camera_time_s + self._differences[0][1]
