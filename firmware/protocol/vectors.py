"""Test vectors that both sides read: checksums, lines out of noise, and what requests and messages say.

Expected results are written down here by hand; only checksums are computed.
"""

import binascii
import json
from typing import Any

BODIES = ["", "#1 PING", "#65535 MOVE 0 -10000000", "=1 ok 123456", "?crc", "~0 0 0 0 0 0", "123456789"]

REQUESTS: list[tuple[str, Any]] = [
    ("#0 HELLO", (0, "HELLO", [])),
    ("#7 MOVE 1 -20", (7, "MOVE", [1, -20])),
    ("#65535 HB 500", (65535, "HB", [500])),
    ("#3 EVENTS 4294967295", (3, "EVENTS", [4294967295])),
    ("#4 SCAN -10 2000 497368 120 40000", (4, "SCAN", [-10, 2000, 497368, 120, 40000])),
    ("#5 NOTHING", (5, "unknown-verb")),
    ("#5 move 0 1", (5, "unknown-verb")),
    ("#6 MOVE 0", (6, "bad-arguments")),
    ("#6 MOVE 0 1 2", (6, "bad-arguments")),
    ("#6 MOVE 0 1.5", (6, "bad-arguments")),
    ("#6 MOVE 0 +1", (6, "bad-arguments")),
    ("#6 MOVE 0 01", (6, "bad-arguments")),
    ("#6 MOVE 0 -0", (6, "bad-arguments")),
    ("#6 MOVE 2 0", (6, "out-of-range")),
    ("#6 MOVE 0 10000001", (6, "out-of-range")),
    ("#6 MOVE 0 99999999999999999999", (6, "out-of-range")),
    ("#65536 PING", None),
    ("#-1 PING", None),
    ("#01 PING", None),
    ("# PING", None),
    ("#1", None),
    ("#1 ", None),
    ("#1  PING", None),
    ("#1 PING ", None),
    ("PING", None),
    ("=1 ok", None),
    ("", None),
]

MESSAGES: list[tuple[str, Any]] = [
    ("=12 ok", {"kind": "answer", "seq": 12, "ok": True, "words": []}),
    ("=12 ok 5 ABC", {"kind": "answer", "seq": 12, "ok": True, "words": ["5", "ABC"]}),
    ("=12 err latched", {"kind": "answer", "seq": 12, "ok": False, "words": ["latched"]}),
    (
        "!3 4294967295 motion-end 10 -5 17 0",
        {"kind": "event", "n": 3, "t_us": 4294967295, "event": "motion-end", "cart": 10, "slide": -5, "a": 17, "b": 0},
    ),
    (
        "~9 100 160 -8 30000 3",
        {"kind": "telemetry", "n": 9, "t_us": 100, "cart": 160, "slide": -8, "adc": [30000], "flags": 3},
    ),
    (
        "~9 100 160 -8 1 2 3 4 0",
        {"kind": "telemetry", "n": 9, "t_us": 100, "cart": 160, "slide": -8, "adc": [1, 2, 3, 4], "flags": 0},
    ),
    ("?crc", {"kind": "bad-line", "why": "crc"}),
    ("?anything", None),
    ("=12 maybe", None),
    ("=12 err", None),
    ("=12 err latched now", None),
    ("!3 1 no-such-event 0 0 0 0", None),
    ("!3 4294967296 boot 0 0 0 0", None),
    ("!3 1 boot 0 0 0", None),
    ("~9 100 160 -8 1 2 0", None),
    ("~9 100 160 -8 x 0", None),
    ("~-1 100 160 -8 1 0", None),
    ("#1 PING", None),
    ("", None),
]


def crc(body: bytes) -> str:
    """CRC-16/CCITT-FALSE, four capital hexadecimal digits."""
    return f"{binascii.crc_hqx(body, 0xFFFF):04X}"


def line(body: str) -> bytes:
    """A whole line."""
    return f"{body}*{crc(body.encode())}\n".encode()


def streams(longest: int) -> list[tuple[str, bytes, list[str], list[str]]]:
    """Names, bytes, the bodies that are to come out, and why the other lines are bad, in order."""
    ping, good = line("#1 PING"), line("#2 STATUS")
    fits = "#3 " + "A" * (longest - len("#3 *CCCC"))
    return [
        ("two lines", ping + good, ["#1 PING", "#2 STATUS"], []),
        ("carriage returns", ping[:-1] + b"\r\n" + good, ["#1 PING", "#2 STATUS"], []),
        ("empty lines", b"\n\r\n" + ping + b"\n\n", ["#1 PING"], []),
        ("a line that has not ended", good + ping[:-1], ["#2 STATUS"], []),
        ("noise before a line", b"\x00\xff\x80*\n" + ping, ["#1 PING"], ["form"]),
        ("noise that runs into a line", b"\x00\xff" + ping + good, ["#2 STATUS"], ["form"]),
        ("a changed byte", ping.replace(b"PING", b"PONG") + good, ["#2 STATUS"], ["crc"]),
        ("a lost byte", ping.replace(b"PING", b"PIG") + good, ["#2 STATUS"], ["crc"]),
        ("a lost newline", ping[:-1] + good, [], ["form"]),
        ("an extra newline", ping[:4] + b"\n" + ping[4:] + good, ["#2 STATUS"], ["form", "crc"]),
        (
            "a checksum in small letters",
            ping.replace(crc(b"#1 PING").encode(), crc(b"#1 PING").lower().encode()),
            [],
            ["form"],
        ),
        ("a checksum of three digits", ping[:-2] + b"\n", [], ["form"]),
        ("no checksum", b"#1 PING\n", [], ["form"]),
        ("a bare checksum", line(""), [""], []),
        ("a control character with a right checksum", line("#1\tPING"), [], ["form"]),
        ("the longest line", line(fits) + ping, [fits, "#1 PING"], []),
        ("one byte too long", line(fits + "A") + ping, ["#1 PING"], ["long"]),
        ("far too long", b"#" * 5000 + b"\n" + ping, ["#1 PING"], ["long"]),
    ]


def render(protocol: dict[str, Any]) -> str:
    """The vectors' text, one JSON object in each line."""
    limits = {limit["name"]: limit["value"] for limit in protocol["limit"]}
    rows: list[dict[str, Any]] = [{"kind": "protocol", "hash": protocol["hash"], "version": protocol["version"]}]
    rows += [{"kind": "crc", "body": body, "crc": crc(body.encode())} for body in BODIES]
    rows += [
        {"kind": "stream", "name": name, "hex": data.hex(), "bodies": bodies, "bad": bad}
        for name, data, bodies, bad in streams(limits["line_bytes"])
    ]
    for body, expected in REQUESTS:
        row: dict[str, Any] = {"kind": "request", "body": body, "seq": None}
        if expected is not None and len(expected) == 2:
            row |= {"seq": expected[0], "error": expected[1]}
        elif expected is not None:
            row |= {"seq": expected[0], "verb": expected[1], "arguments": expected[2]}
        rows.append(row)
    rows += [{"kind": "message", "body": body, "expected": expected} for body, expected in MESSAGES]
    return "".join(json.dumps(row) + "\n" for row in rows)
