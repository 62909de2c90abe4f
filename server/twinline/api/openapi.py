"""The committed description of the API: ``python -m twinline.api.openapi`` writes it, a test compares it."""

import json
from pathlib import Path

from twinline.api.application import build_api

FILE = Path(__file__).parents[2] / "openapi.json"


def document() -> str:
    """The API's OpenAPI document as it is committed."""
    return json.dumps(build_api().openapi(), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    FILE.write_text(document(), encoding="utf-8")
