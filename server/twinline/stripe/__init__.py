"""Pixels -> sub-pixel stripe centres with variance and flags."""

from twinline.stripe.extraction import extract
from twinline.stripe.model import (
    CHANNELS,
    METHODS,
    Channel,
    ExtractionSettings,
    Flag,
    Method,
    StripeProfile,
)

__all__ = ["CHANNELS", "METHODS", "Channel", "ExtractionSettings", "Flag", "Method", "StripeProfile", "extract"]
