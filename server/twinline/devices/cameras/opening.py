"""From an address to the camera that stands there."""

from pathlib import Path

from twinline.devices.camera import Camera
from twinline.devices.cameras.settings import CameraSettings
from twinline.devices.cameras.threaded import SourceMaker, ThreadedCamera
from twinline.errors import SettingsError


def open_camera(settings: CameraSettings | str) -> Camera:
    """Choose the kind of camera by its address. Nothing is touched before its ``open`` is called.

    Parameters
    ----------
    settings
        The settings, or the address alone: ``uvc:0``, ``rtsp://...``, ``http://...``, a video file, a folder.

    Raises
    ------
    SettingsError
        If no kind of camera has such an address.
    """
    chosen = CameraSettings(settings) if isinstance(settings, str) else settings
    return ThreadedCamera(chosen, _source_maker(chosen.url))


def _source_maker(url: str) -> SourceMaker:
    # Each kind brings a large library along, of which only the one that is needed is loaded.
    scheme, colon, _ = url.partition(":")
    scheme = scheme.lower()
    if scheme == "uvc" and colon:
        from twinline.devices.cameras.uvc import camera_number, system_uvc_source

        camera_number(url)
        return system_uvc_source
    if "://" in url and scheme in {"http", "https"}:
        from twinline.devices.cameras.address import parse_address
        from twinline.devices.cameras.mjpeg import MjpegSource

        parse_address(url)
        return MjpegSource
    if "://" in url and scheme in {"rtsp", "rtsps"}:
        from twinline.devices.cameras.address import parse_address

        parse_address(url)
        try:
            from twinline.devices.cameras.rtsp import RtspSource
        except ModuleNotFoundError as error:
            if error.name != "av":
                raise
            raise SettingsError(
                "RTSP cameras need the Python package av (FFmpeg), which is not installed: install twinline[rtsp], or "
                "use the address of the camera's MJPEG stream, http://..."
            ) from error
        return RtspSource
    if "://" in url:
        raise SettingsError(
            f"There is no kind of camera for {scheme}://: use uvc:0, rtsp://, http://, https://, a video or a folder."
        )
    if Path(url).is_dir():
        from twinline.devices.cameras.picture_folder import PictureFolderSource

        return PictureFolderSource
    from twinline.devices.cameras.video_file import VideoFileSource

    return VideoFileSource
