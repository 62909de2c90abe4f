"""The protocol as a Python module."""

from typing import Any

HEAD = '''"""The serial protocol's vocabulary, generated from firmware/protocol/protocol.toml; do not edit."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag, StrEnum
from types import MappingProxyType
'''

SPECIFICATION = '''@dataclass(frozen=True)
class Argument:
    """An argument of a verb: a decimal integer within limits.

    Attributes
    ----------
    name
        What it is.
    unit
        Its unit; empty for a plain number.
    low, high
        Lowest and highest permitted value.
    """

    name: str
    unit: str
    low: int
    high: int


@dataclass(frozen=True)
class VerbSpecification:
    """What belongs to a verb.

    Attributes
    ----------
    session
        Whether HELLO must have come before.
    again
        Whether it runs each time it comes, rather than once for each sequence number.
    arguments
        What follows the verb.
    words
        For each field of a positive answer its name and whether it is a word rather than an integer.
    """

    session: bool
    again: bool
    arguments: tuple[Argument, ...]
    words: tuple[tuple[str, bool], ...]

'''


def render(protocol: dict[str, Any]) -> str:
    """The module's text, formatted as ruff would."""
    parts = [HEAD, f'PROTOCOL_NAME = "{protocol["name"]}"', f"PROTOCOL_VERSION = {protocol['version']}"]
    parts += [f'PROTOCOL_HASH = "{protocol["hash"]}"', '"""Covers everything but the texts."""', ""]
    for limit in protocol["limit"]:
        unit = f" Unit: {limit['unit']}." if limit["unit"] else ""
        parts += [f"{_upper(limit['name'])} = {limit['value']}", f'"""{limit["text"]}{unit}"""']
    parts += ["", ""]
    parts += _enum("Verb", "StrEnum", "What the host may ask for.", _named(protocol["verb"]))
    parts += _enum("ErrorCode", "StrEnum", "Why the board refuses.", _named(protocol["error"]))
    parts += _enum("EventKind", "StrEnum", "What the board tells of its own accord.", _named(protocol["event"]))
    flags = [(_upper(flag["name"]), f"1 << {flag['bit']}", flag["text"]) for flag in protocol["flag"]]
    parts += _enum("Flag", "IntFlag", "State of the board, as bits.", flags)
    axes = [(_upper(axis["name"]), str(axis["number"]), f"The {axis['name']}.") for axis in protocol["axis"]]
    parts += _enum("AxisNumber", "IntEnum", "Axes.", axes)
    for values in protocol["values"]:
        members = [(_upper(m["name"]), str(m["number"]), _sentence(m["text"])) for m in values["members"]]
        parts += _enum(_camel(values["name"]), "IntEnum", values["text"], members)
    parts.append(SPECIFICATION)
    parts += _verbs(protocol)
    parts += _axis_defaults(protocol)
    return "\n".join(parts) + "\n"


def _verbs(protocol: dict[str, Any]) -> list[str]:
    lines = ["VERBS: Mapping[Verb, VerbSpecification] = MappingProxyType(", "    {"]
    for verb in protocol["verb"]:
        lines += [f"        Verb.{verb['name']}: VerbSpecification(", f"            session={verb['session']},"]
        lines.append(f"            again={verb['again']},")
        lines += _tuple(
            "arguments",
            [f'Argument("{a["name"]}", "{a.get("unit", "")}", {a["low"]}, {a["high"]})' for a in verb["arguments"]],
        )
        lines += _tuple("words", [f'("{a["name"]}", {a.get("word", False)})' for a in verb["answers"]])
        lines.append("        ),")
    return [*lines, "    }", ")"]


def _tuple(name: str, items: list[str]) -> list[str]:
    one_line = f"            {name}=({', '.join(items)}{',' if len(items) == 1 else ''}),"
    # A trailing comma within keeps the formatter from joining the lines of a longer one again.
    if len(items) < 2:
        return [one_line]
    return [f"            {name}=(", *(f"                {item}," for item in items), "            ),"]


def _axis_defaults(protocol: dict[str, Any]) -> list[str]:
    lines = []
    for key, text in (("default_rate_msteps_s", "Rate"), ("default_acceleration_steps_s2", "Acceleration")):
        lines += [f"{_upper(key)}: Mapping[AxisNumber, int] = MappingProxyType(", "    {"]
        lines += [f"        AxisNumber.{_upper(axis['name'])}: {axis[key]}," for axis in protocol["axis"]]
        lines += ["    }", ")", f'"""{text} of each axis until SPEED sets another."""']
    return lines


def _enum(name: str, kind: str, text: str, members: list[tuple[str, str, str]]) -> list[str]:
    lines = [f"class {name}({kind}):", f'    """{text}"""', ""]
    for member, value, meaning in members:
        lines += [f"    {member} = {value}", f'    """{meaning}"""']
    return [*lines, "", ""]


def _named(entries: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    return [(_upper(entry["name"]), f'"{entry["name"]}"', entry["text"]) for entry in entries]


def _upper(name: str) -> str:
    return name.upper().replace("-", "_")


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("-"))


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."
