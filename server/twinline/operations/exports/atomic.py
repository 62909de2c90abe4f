"""Files that are whole or not there; the layers below exports write theirs in the same way."""

from twinline.recording.atomic_file import atomic_path

__all__ = ["atomic_path"]
