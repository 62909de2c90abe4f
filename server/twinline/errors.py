"""Every error that Twinline raises on purpose, with its stable code.

An error carries a kebab-case ``code`` for programs and a ``detail`` for people: what is wrong, with numbers and
units, and the next step. It knows nothing of HTTP or exit statuses; the edges translate it.

    TwinlineError
    |-- InputError              what the caller gave cannot be used
    |   |-- CaptureError        a capture folder, or something in it
    |   |-- FrameError          one picture or video
    |   |-- RigError            a rig file, or a rig that does not fit the data
    |   |-- CalibrationError    the observations do not determine a calibration
    |   |-- StripeError         no usable stripe, or an impossible extraction setting
    |   |-- SettingsError       settings file, environment or option
    |   `-- ControlError        a camera control that does not exist, or a value outside its limits
    |-- OutputError             the result cannot be written
    |-- NotFoundError           no such job, scan, file
    |-- TransitionError         not possible in the present state
    |-- CancelledError          somebody asked for it to stop
    |-- WorkerError             a worker process died
    `-- DeviceError             board, camera or another device does not do what it should
        |-- CameraError         no camera, or no usable frames
        |-- LinkError           the connection is lost, or cannot be made
        |-- DeviceTimeoutError  connected, and no answer in time
        |-- RefusedError        the board refused a command
        `-- MotionError         a movement ended before it was complete
"""

from typing import ClassVar


class TwinlineError(Exception):
    """Base of all errors raised on purpose.

    Parameters
    ----------
    detail
        One sentence with the cause and the next step.
    code
        Stable kebab-case code; the class's own where it is not given.
    """

    default_code: ClassVar[str] = "internal"

    def __init__(self, detail: str, *, code: str | None = None) -> None:
        super().__init__(detail)
        self.detail = detail
        self.code = code or self.default_code

    def __reduce__(self) -> tuple[object, ...]:
        # Errors cross process borders; the default would lose the code.
        return (_rebuild, (type(self), self.detail, self.code))


def _rebuild(cls: type[TwinlineError], detail: str, code: str) -> TwinlineError:
    return cls(detail, code=code)


class InputError(TwinlineError):
    """What the caller gave cannot be used."""

    default_code = "bad-input"


class CaptureError(InputError):
    """A capture folder, or something in it, cannot be used."""

    default_code = "bad-capture"


class FrameError(InputError):
    """A picture or a video cannot be read."""

    default_code = "bad-frame"


class RigError(InputError):
    """A rig file cannot be read, or the rig does not fit the data."""

    default_code = "bad-rig"


class StripeError(InputError):
    """No usable stripe, or an impossible extraction setting."""

    default_code = "no-stripe"


class CalibrationError(InputError):
    """The observations do not determine a calibration, or contradict each other."""

    default_code = "cannot-calibrate"


class SettingsError(InputError):
    """A setting is wrong."""

    default_code = "bad-settings"


class OutputError(TwinlineError):
    """A result cannot be written."""

    default_code = "cannot-write"


class NotFoundError(TwinlineError):
    """There is no such thing."""

    default_code = "not-found"


class TransitionError(TwinlineError):
    """Not possible in the present state."""

    default_code = "not-possible-now"


class CancelledError(TwinlineError):
    """Somebody asked for the work to stop."""

    default_code = "cancelled"


class WorkerError(TwinlineError):
    """A worker process died."""

    default_code = "worker-died"


class DeviceError(TwinlineError):
    """Board, camera or another device does not do what it should."""

    default_code = "device-fault"


class CameraError(DeviceError):
    """There is no camera, or it sends no usable frames."""

    default_code = "camera-fault"


class ControlError(InputError):
    """A camera control does not exist, or the value is outside its limits."""

    default_code = "bad-control"


class LinkError(DeviceError):
    """The connection to a device is lost, or cannot be made."""

    default_code = "disconnected"


class DeviceTimeoutError(DeviceError):
    """A device is connected and does not answer in time."""

    default_code = "device-timeout"


class RefusedError(DeviceError):
    """The board refused a command; the code tells why."""

    default_code = "refused"


class MotionError(DeviceError):
    """A movement ended before it was complete; the code tells why."""

    default_code = "motion-ended"
