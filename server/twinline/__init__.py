"""Twinline: control server for a cart scanner with twin line lasers, a camera and a ToF sensor."""

from importlib.metadata import version

__version__ = version("twinline")
