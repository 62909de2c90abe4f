"""Frames that never came, from the gaps in the camera's own time stamps."""

from collections import deque
from statistics import median

_STEPS = 15
_ENOUGH_STEPS = 7
_TOLERANCE = 0.15


class StampGaps:
    """Counts frames that a camera made and did not deliver.

    A gap counts where the stamps before it were regular and it is a whole number of steps long. A camera that changes
    its rate is so taken for a loss for the few frames that it takes to learn the new one.
    """

    def __init__(self) -> None:
        self._steps: deque[float] = deque(maxlen=_STEPS)
        self._last_s: float | None = None

    def missing(self, stamp_s: float | None) -> int:
        """Frames missing between this one and the one before.

        Parameters
        ----------
        stamp_s
            The camera's time of this frame; None if it gives none.
        """
        last_s, self._last_s = self._last_s, stamp_s
        if stamp_s is None or last_s is None:
            return 0
        step_s = stamp_s - last_s
        if step_s <= 0:
            self.restart()
            self._last_s = stamp_s
            return 0
        steps = step_s / median(self._steps) if len(self._steps) >= _ENOUGH_STEPS else 1.0
        self._steps.append(step_s)
        return round(steps) - 1 if steps > 1.5 and abs(steps - round(steps)) <= _TOLERANCE else 0

    def restart(self) -> None:
        """Forget all stamps: after a new connection they may have another zero."""
        self._steps.clear()
        self._last_s = None
