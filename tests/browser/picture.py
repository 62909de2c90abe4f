"""What a screenshot shows."""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from playwright.sync_api import Page

Picture = npt.NDArray[np.uint8]


def picture_of(page: Page, selector: str) -> Picture:
    """Screenshot of an element, (h, w, 3) BGR."""
    png = page.locator(selector).screenshot()
    decoded = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    return np.asarray(decoded, np.uint8)


def middle(picture: Picture) -> Picture:
    """The inner part of the stage, without the labels that lie on its corners."""
    height, width = picture.shape[:2]
    return picture[height // 8 : -height // 8, width // 20 : -width // 20]


def lit_share(picture: Picture) -> float:
    """Share of pixels that stand out from the most frequent colour: points, not ground."""
    flat = picture.reshape(-1, 3).astype(np.int32)
    packed = flat @ np.array([1, 256, 65536])
    ground = flat[packed == np.bincount(packed).argmax()][0]
    return float((np.abs(flat - ground).max(axis=1) > 40).mean())


def colourfulness(picture: Picture) -> int:
    """Number of distinct hues (in tenths of the circle) among clearly coloured pixels."""
    hsv = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2HSV))
    coloured = hsv[(hsv[..., 1] > 90) & (hsv[..., 2] > 60)]
    tenths, counts = np.unique(coloured[:, 0] // 18, return_counts=True)
    return int((counts > max(20, counts.sum() // 200)).sum()) if len(tenths) else 0


def wait_for_points(page: Page, *, at_least: float = 0.01) -> Picture:
    """The stage's picture once points are drawn; the viewer draws some time after the page has them."""
    seen: list[Any] = []
    for _ in range(120):
        picture = middle(picture_of(page, "#stage .stage"))
        share = lit_share(picture)
        if share >= at_least:
            return picture
        seen.append(round(share, 4))
        page.wait_for_timeout(500)
    raise AssertionError(f"no points in the 3-D view: the lit share of its picture stayed at {sorted(set(seen))}")
