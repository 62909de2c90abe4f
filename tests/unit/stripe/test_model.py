"""What extraction is asked for and what it answers."""

import numpy as np
import pytest

from twinline.errors import StripeError
from twinline.stripe import CHANNELS, METHODS, ExtractionSettings, Flag, StripeProfile


def test_every_method_and_channel_can_be_asked_for() -> None:
    for method in METHODS:
        for channel in CHANNELS:
            assert ExtractionSettings(method=method, channel=channel).method == method


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"method": "parabola"}, "Unknown extraction method 'parabola'; choose one of maximum-likelihood, gaussian"),
        ({"channel": "infrared"}, "Unknown channel 'infrared'; choose one of auto, gray"),
        ({"saturation_dn": 1}, "saturation level must be between 2 and 256, not 1"),
        ({"saturation_dn": 257}, "saturation level must be between 2 and 256, not 257"),
    ],
)
def test_impossible_settings_are_refused_in_words(settings: dict[str, object], words: str) -> None:
    with pytest.raises(StripeError, match=words):
        ExtractionSettings(**settings)  # type: ignore[arg-type]


def test_an_empty_profile_has_found_nothing() -> None:
    profile = StripeProfile.empty(2, 5)
    assert profile.centre_px.shape == profile.misfit.shape == (2, 5)
    assert not profile.found.any()
    assert (profile.flags == int(Flag.MISSING)).all()
    assert np.isnan(profile.runner_up_dn).all()


def test_flags_are_distinct_bits_of_sixteen() -> None:
    bits = [int(flag) for flag in Flag]
    assert all(b.bit_count() == 1 for b in bits)
    assert len(set(bits)) == len(bits)
    assert max(bits) < 2**16
