"""What the pictures of a laser pass tell: a stripe that is missing, a scene that stands still."""

import numpy as np
import pytest

from twinline.arrays import ByteArray
from twinline.devices.camera import CameraFrame, Encoding
from twinline.operations.passes.picture_watch import PictureWatch

SIZE = (640, 360)
BOTH = frozenset({1, 2})
STEP_MM, STEP_S, STEP_PX = 8.0, 0.2, 24
RNG = np.random.default_rng(20261122)
BED = RNG.normal(90.0, 25.0, (60, 40)).clip(0, 255)


def picture(place: int, rows: tuple[int, ...], *, colour: bool = True, texture: bool = True) -> ByteArray:
    """Blotches that go by with the travel, and red stripes at some rows."""
    bed = np.kron(BED, np.ones((16, 16))) if texture else np.full((960, 640), 90.0)
    view = bed[place * STEP_PX : place * STEP_PX + SIZE[1]].repeat(3).reshape(SIZE[1], SIZE[0], 3)
    for row in rows:
        view[row : row + 5] = (60.0, 60.0, 230.0)
    noisy = view + RNG.normal(0.0, 1.0, view.shape)
    image = noisy.clip(0, 255).astype(np.uint8)
    return image if colour else image[:, :, 2].copy()


def watch(pictures: list[ByteArray], lasers: frozenset[int] = BOTH) -> tuple[str, ...]:
    eye = PictureWatch("along-u")
    for number, image in enumerate(pictures):
        encoding: Encoding = "bgr8" if image.ndim == 3 else "gray8"
        frame = CameraFrame(number, STEP_S * number, None, encoding, image.tobytes(), SIZE)
        eye.frame(frame, lasers, STEP_MM * number)
    return eye.warnings()


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("texture", [True, False])
def test_a_good_pass_is_not_complained_of(colour: bool, texture: bool) -> None:
    assert watch([picture(k, (80, 280), colour=colour, texture=texture) for k in range(8)]) == ()


@pytest.mark.parametrize(("left", "missing"), [((80,), "laser 1"), ((280,), "laser 2"), ((), "laser 1 and laser 2")])
def test_a_stripe_that_is_missing_is_named(left: tuple[int, ...], missing: str) -> None:
    (warning,) = watch([picture(k, (80, 280) if k < 4 else left) for k in range(8)])
    assert f"From 32 mm on the pictures lack the stripe of {missing};" in warning


def test_a_stripe_that_is_hidden_for_a_moment_is_not_missed() -> None:
    assert watch([picture(k, (80,) if k in {3, 4} else (80, 280)) for k in range(8)]) == ()


def test_a_scene_that_stands_still_while_the_cart_should_move_is_told() -> None:
    (warning,) = watch([picture(min(k, 4), (80, 280)) for k in range(9)])
    assert "From 32 mm on the picture stands still" in warning


def test_pictures_that_cannot_be_decoded_are_passed_over() -> None:
    eye = PictureWatch("along-u")
    for number in range(5):
        eye.frame(CameraFrame(number, float(number), None, "jpeg", b"nothing", SIZE), BOTH, 10.0 * number)
    assert eye.warnings() == ()
