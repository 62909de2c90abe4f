"""The test vectors that firmware and host share."""

import json
from pathlib import Path
from typing import Any

PROTOCOL = Path(__file__).resolve().parents[4] / "firmware" / "protocol"


def vectors(kind: str) -> list[dict[str, Any]]:
    """All vectors of one kind."""
    lines = (PROTOCOL / "vectors.jsonl").read_text(encoding="utf-8").splitlines()
    return [row for row in map(json.loads, lines) if row["kind"] == kind]
