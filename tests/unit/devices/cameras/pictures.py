"""Pictures that the camera tests send around."""

import cv2
import numpy as np

from twinline.arrays import ByteArray

SIZE = (160, 120)


def make_images(count: int, *, size: tuple[int, int] = SIZE, seed: int = 20261122) -> list[ByteArray]:
    """Colour pictures that differ from each other: a bright line at another height on each, and some noise."""
    width, height = size
    rng = np.random.default_rng(seed)
    images = []
    for number in range(count):
        image = rng.integers(0, 30, (height, width, 3), dtype=np.uint8)
        row = (7 * number) % (height - 4)
        image[row : row + 3, :, 2] = 230
        images.append(image)
    return images


def make_jpegs(count: int, *, size: tuple[int, int] = SIZE, seed: int = 20261122) -> list[bytes]:
    """The same as JPEG."""
    return [cv2.imencode(".jpg", image)[1].tobytes() for image in make_images(count, size=size, seed=seed)]
