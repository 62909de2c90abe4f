"""A recording that was cut off, written anew as a whole one; the original stays as it is."""

from pathlib import Path

from twinline.errors import CaptureError
from twinline.recording.atomic_file import atomic_path
from twinline.recording.container_file import ContainerFile
from twinline.recording.container_walk import walk
from twinline.recording.pass_header import METADATA, parse_header
from twinline.recording.pass_messages import Message


def repair(path: Path, output: Path) -> tuple[str, ...]:
    """Copy every complete message of a recording into a new file with an index.

    Opening a recording needs no repair; other tools may.

    Returns
    -------
    tuple of str
        What is missing or damaged, also inside messages; empty if the recording was whole.

    Raises
    ------
    CaptureError
        If the file cannot be read, or is no recording.
    OutputError
        If the new file cannot be written; nothing is left behind then.
    """
    contents = walk(path, check=True)
    parse_header(path, contents.metadata.get(METADATA), contents.files)
    with atomic_path(output) as temporary:
        copy = ContainerFile(temporary, METADATA, contents.metadata[METADATA], contents.files)
        try:
            with path.open("rb", buffering=0) as source:
                for message in contents.messages:
                    source.seek(message.offset)
                    data = source.read(message.length) or b""
                    if len(data) < message.length:
                        raise CaptureError(f"{path} became shorter while it was copied; try again.")
                    copy.add(Message(message.topic, message.time_ns, message.sequence, data))
            copy.finish()
        finally:
            copy.abandon()
    return tuple(contents.problems)
