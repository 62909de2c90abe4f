"""Small captures that tests make and then damage."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

SIZE = (64, 48)


def description() -> dict[str, Any]:
    """A complete ``capture.json``."""
    return {
        "name": "three objects",
        "image_size": list(SIZE),
        "stripe_runs": "along-u",
        "camera_matrix_guess": [[50, 0, 32], [0, 50, 24], [0, 0, 1]],
        "board": {"kind": "chessboard", "columns": 9, "rows": 6, "square_mm": 12.0, "thickness_mm": 0.0},
        "camera_height_mm": 430.0,
        "lasers": [
            {"baseline_mm": 246.0, "angle_deg": 60.0, "side": "+v"},
            {"baseline_mm": 246.0, "angle_deg": 60.0, "side": "-v"},
        ],
        "tof": {"range_mm": [60, 140], "volts": [-4, 4], "adc_counts": 4096, "mount_mm": [-118.0, 0.0, 139.0]},
    }


def picture(number: int, size: tuple[int, int] = SIZE) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """A colour picture whose eight blocks spell its number in binary, so that decoding tells which one it is."""
    image = np.full((size[1], size[0], 3), 40, np.uint8)
    for bit in range(8):
        if number >> bit & 1:
            image[8:40, bit * 8 : bit * 8 + 8] = 230
    return image


def number_of(image: np.ndarray[Any, Any]) -> int:
    """The number that `picture` wrote."""
    return sum(1 << bit for bit in range(8) if image[16:32, bit * 8 + 2 : bit * 8 + 6].mean() > 128)


def write_pictures(folder: Path, count: int, suffix: str = ".png") -> list[str]:
    """Write numbered pictures and their ``frames.csv``, 40 ms and 1 mm apart; returns their names."""
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"{i:04d}{suffix}" for i in range(count)]
    for i, name in enumerate(names):
        assert cv2.imwrite(str(folder / name), picture(i))
    write_list(folder, names)
    return names


def write_list(folder: Path, names: list[str]) -> None:
    lines = [f"{name},{i * 0.04:.2f},{i}" for i, name in enumerate(names)]
    (folder / "frames.csv").write_text("\n".join(["frame,time_s,cart_mm", *lines, ""]))


def write_video(folder: Path, name: str, codec: str, count: int) -> Path:
    """Write a video of numbered pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), 25, SIZE)
    assert writer.isOpened()
    for i in range(count):
        writer.write(picture(i))
    writer.release()
    return path
