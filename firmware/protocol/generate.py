#!/usr/bin/env python3
"""Generate everything that both sides share from protocol.toml.

    python firmware/protocol/generate.py            write the files
    python firmware/protocol/generate.py --check    exit status 1 if one of them is not up to date

Standard library only, so that the firmware builds on a machine that has nothing else.
"""

import hashlib
import json
import sys
import tomllib
from pathlib import Path
from typing import Any

# Beside this file, whose folder is no package: a script finds its neighbours by itself.
import c_header
import document
import python_module
import vectors

HERE = Path(__file__).resolve().parent
SOURCE = HERE / "protocol.toml"
UNIQUE = (
    *((kind, "name") for kind in ("limit", "axis", "verb", "error", "event", "flag", "values")),
    ("axis", "number"),
    ("flag", "bit"),
)
PYTHON_MODULE = HERE.parents[1] / "server" / "twinline" / "devices" / "serial" / "protocol_gen.py"


class ProtocolError(Exception):
    """protocol.toml contradicts itself."""


def load(path: Path = SOURCE) -> dict[str, Any]:
    """The protocol as protocol.toml has it, with its hash.

    Raises
    ------
    ProtocolError
        Two things of one kind with one name, number or bit; a range that is empty.
    """
    protocol = tomllib.loads(path.read_text(encoding="utf-8"))
    check(protocol)
    protocol["hash"] = digest(protocol)
    return protocol


def check(protocol: dict[str, Any]) -> None:
    """Refuse a protocol that contradicts itself."""
    for kind, key in UNIQUE:
        _all_different([entry[key] for entry in protocol[kind]], f"{kind} {key}")
    for verb in protocol["verb"]:
        _all_different([argument["name"] for argument in verb["arguments"]], f"argument of {verb['name']}")
        for argument in verb["arguments"]:
            if argument["low"] > argument["high"]:
                raise ProtocolError(f"{verb['name']} {argument['name']}: the lowest value is above the highest")
    for values in protocol["values"]:
        _all_different([member["number"] for member in values["members"]], f"number of {values['name']}")


def _all_different(names: list[Any], what: str) -> None:
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ProtocolError(f"{what} given twice: {sorted(twice)}")


def digest(protocol: dict[str, Any]) -> str:
    """Eight hexadecimal digits over everything but the texts."""
    canonical = json.dumps(_without_texts(protocol), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:8].upper()


def _without_texts(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_texts(item) for key, item in value.items() if key not in {"text", "hash"}}
    if isinstance(value, list):
        return [_without_texts(item) for item in value]
    return value


def outputs(protocol: dict[str, Any]) -> dict[Path, str]:
    """Every generated file with what belongs in it."""
    return {
        PYTHON_MODULE: python_module.render(protocol),
        HERE / "protocol_gen.h": c_header.render(protocol),
        HERE / "PROTOCOL.md": document.render(protocol),
        HERE / "vectors.jsonl": vectors.render(protocol),
    }


def main(arguments: list[str]) -> int:
    """Write the files, or compare them."""
    if arguments not in ([], ["--check"]):
        sys.stderr.write(__doc__ or "")
        return 2
    stale = 0
    for path, text in outputs(load()).items():
        if path.is_file() and path.read_text(encoding="utf-8") == text:
            continue
        if arguments:
            sys.stderr.write(f"{path.name} is not up to date; run python firmware/protocol/generate.py\n")
            stale = 1
        else:
            path.write_text(text, encoding="utf-8", newline="\n")
            sys.stdout.write(f"wrote {path.name}\n")
    return stale


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
