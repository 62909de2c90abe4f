"""What must be known of a camera before it is opened."""

from dataclasses import dataclass, field

from twinline.errors import SettingsError


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """A camera's address, and how to treat it.

    Attributes
    ----------
    url
        ``uvc:0``, ``rtsp://...``, ``http://...``, ``https://...``, or the path of a video or of a folder of pictures.
        User and password stand in the address, as in ``rtsp://user:password@camera/stream``; they appear in no message.
    latency_s
        Time from the end of an exposure to the arrival of its frame: reading the sensor, coding, the network. What
        remains of it moves every position stamp by speed times time, so it is worth measuring.
    exposure_s
        Length of the exposure of cameras that do not tell it; None if not known, which counts as 0 in time stamps.
    image_size : (int, int) or None
        Width and height in pixels to ask a USB camera for; its own choice where None.
    rate_hz
        Frames per second to ask a USB camera for, and to play a folder or video with; its own (a folder: 25) where
        None.
    paced
        Whether a folder or video plays like a camera, at its rate and losing frames that nobody takes in time;
        otherwise as fast as its frames are taken, with none lost.
    queue_frames
        Frames kept for a reader that is busy.
    connect_s
        How long connecting may take.
    stall_s
        How long a connected camera may be silent before it is taken for lost.
    retry_s : (float, float)
        First and longest pause before connecting again; it doubles from one to the other.
    """

    # The address may hold a password: it stays out of logs and tracebacks.
    url: str = field(repr=False)
    latency_s: float = 0.0
    exposure_s: float | None = None
    image_size: tuple[int, int] | None = None
    rate_hz: float | None = None
    paced: bool = True
    queue_frames: int = 8
    connect_s: float = 5.0
    stall_s: float = 5.0
    retry_s: tuple[float, float] = (0.25, 5.0)

    def __post_init__(self) -> None:
        wrong = [
            f"{name} is {value:g}{unit}, where {what} is needed"
            for name, value, unit, what, fine in (
                ("latency_s", self.latency_s, " s", "0 to 10 s", 0 <= self.latency_s <= 10),
                ("exposure_s", self.exposure_s or 0.0, " s", "0 to 10 s", 0 <= (self.exposure_s or 0.0) <= 10),
                ("rate_hz", self.rate_hz or 0.0, " Hz", "more than 0", self.rate_hz is None or self.rate_hz > 0),
                ("queue_frames", self.queue_frames, "", "at least 1", self.queue_frames >= 1),
                ("connect_s", self.connect_s, " s", "more than 0", self.connect_s > 0),
                ("stall_s", self.stall_s, " s", "more than 0", self.stall_s > 0),
                ("retry_s", self.retry_s[0], " s", "more than 0", self.retry_s[0] > 0),
                ("retry_s", self.retry_s[1], " s", "at least the first pause", self.retry_s[1] >= self.retry_s[0]),
            )
            if not fine
        ]
        if wrong:
            raise SettingsError(f"The camera's settings cannot be used: {'; '.join(wrong)}.")
