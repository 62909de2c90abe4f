"""Which light of a picture is measured, and which pictures cannot be."""

import numpy as np
import pytest

from twinline.errors import StripeError
from twinline.stripe import Channel
from twinline.stripe.light import Light, take_light

RNG = np.random.default_rng(9)
COLOUR = RNG.integers(0, 256, (12, 17, 3)).astype(np.uint8)
GRAY = COLOUR[..., 1].copy()
DARK = RNG.integers(0, 40, (12, 17, 3)).astype(np.uint8)


def seen(light: Light) -> np.ndarray:
    """The measured light of every pixel, (rows, columns), by the rule of the class's docstring."""
    value = light.flat[:, light.channel :: light.step].astype(int)
    if light.minus >= 0:
        value = value - light.flat[:, light.minus :: light.step]
    if light.has_off:
        value = value - light.off[:, light.channel :: light.step]
        if light.minus >= 0:
            value = value + light.off[:, light.minus :: light.step]
    return value


@pytest.mark.parametrize(("channel", "index"), [("red", 2), ("green", 1), ("blue", 0), ("auto", 2)])
def test_a_channel_is_read_in_place(channel: Channel, index: int) -> None:
    light = take_light(COLOUR, channel, along_v=False)
    assert np.array_equal(seen(light), COLOUR[..., index])
    assert np.shares_memory(light.flat, COLOUR)


def test_auto_takes_gray_pictures_as_they_are() -> None:
    light = take_light(GRAY, "auto", along_v=False)
    assert np.shares_memory(light.flat, GRAY)
    assert (light.rows, light.columns, light.step) == (12, 17, 1)


def test_red_less_blue_keeps_its_sign() -> None:
    light = take_light(COLOUR, "red-blue", along_v=False)
    assert np.array_equal(seen(light), COLOUR[..., 2].astype(int) - COLOUR[..., 0])


@pytest.mark.parametrize("channel", ["luma", "gray"])
def test_luma_is_the_standard_mixture(channel: Channel) -> None:
    mixture = COLOUR @ np.array([0.114, 0.587, 0.299])
    assert seen(take_light(COLOUR, channel, along_v=False)) == pytest.approx(mixture, abs=1.0)


def test_a_laser_off_picture_is_subtracted_and_its_search_is_not_negative() -> None:
    light = take_light(COLOUR, "red", along_v=False, off=DARK)
    difference = COLOUR[..., 2].astype(int) - DARK[..., 2]
    assert np.array_equal(seen(light), difference)
    assert np.array_equal(light.search[:, 2::3], np.maximum(difference, 0))


def test_a_gray_laser_off_picture_makes_the_colour_one_gray() -> None:
    light = take_light(COLOUR, "auto", along_v=False, off=GRAY)
    assert light.step == 1
    assert light.has_off


@pytest.mark.parametrize("off", [None, DARK])
def test_stripes_along_v_are_those_of_the_transposed_picture(off: np.ndarray | None) -> None:
    turned = take_light(COLOUR, "red", along_v=True, off=off)
    straight = take_light(COLOUR, "red", along_v=False, off=off)
    assert np.array_equal(seen(turned), seen(straight).T)


@pytest.mark.parametrize("channel", ["red", "green", "blue", "red-blue"])
def test_a_gray_picture_has_no_colour(channel: Channel) -> None:
    with pytest.raises(StripeError, match=f'one channel, so "{channel}" cannot be taken from it; use "gray"'):
        take_light(GRAY, channel, along_v=False)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (GRAY.astype(np.uint16), r"must be 8 bits deep with one or three channels, not uint16 \(12, 17\)"),
        (np.zeros((4, 4, 4), np.uint8), r"not uint8 \(4, 4, 4\)"),
        (np.zeros(4, np.uint8), r"not uint8 \(4,\)"),
        (np.zeros((0, 4), np.uint8), "picture is empty"),
    ],
)
def test_what_is_no_picture_is_refused(image: np.ndarray, words: str) -> None:
    with pytest.raises(StripeError, match=words):
        take_light(image, "auto", along_v=False)


def test_a_laser_off_picture_of_another_size_is_refused_with_both_sizes() -> None:
    with pytest.raises(StripeError, match=r"laser-off picture is 17 x 11 px but the picture is 17 x 12"):
        take_light(GRAY, "auto", along_v=False, off=GRAY[1:])
