"""Where a result came from, as every exported file states it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Provenance:
    """What must be known to make the same result again.

    Attributes
    ----------
    rig_id
        Identifier of the rig (calibration) used.
    recording_id
        Identifier of the recording or name of the capture.
    software_version
        Version of Twinline.
    """

    rig_id: str
    recording_id: str
    software_version: str

    def lines(self) -> tuple[tuple[str, str], ...]:
        """Name and value of each field, the value in a single line."""
        fields = (
            ("rig_id", self.rig_id),
            ("recording_id", self.recording_id),
            ("software_version", self.software_version),
        )
        return tuple((name, _single_line(value)) for name, value in fields)


def _single_line(text: str) -> str:
    # A line break in a name would end the comment and become part of a file's header.
    return "".join(c if c.isprintable() else " " for c in text)[:500]
