"""A process that records until somebody kills it; says on standard output what it has handed over, and when."""

import sys
import time
from pathlib import Path

from tests.unit.recording.recorded_passes import header, line, shot
from twinline.recording.pass_writer import PassWriter


def main(path: Path) -> None:
    with PassWriter(path, header()) as writer:
        number = 0
        while True:
            writer.frame(shot(number % 200))
            writer.telemetry(line(number))
            sys.stdout.write(f"{number} {time.monotonic()!r}\n")
            sys.stdout.flush()
            number += 1
            time.sleep(0.004)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
