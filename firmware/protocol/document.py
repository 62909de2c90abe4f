"""The protocol as a document."""

from typing import Any

FRAMING = """\
ASCII lines, each ended by a newline (a carriage return before it is ignored), 115200 baud, 8N1. A line begins with one
of five signs and ends in `*` and the CRC-16/CCITT-FALSE of everything before the `*`, in four capital hexadecimal
digits: polynomial 0x1021, initial value 0xFFFF, not reflected; in Python `binascii.crc_hqx(body, 0xFFFF)`.

    host -> board   #<seq> VERB argument argument*CCCC
    board -> host   =<seq> ok value value*CCCC
                    =<seq> err <error>*CCCC
                    !<n> <t_us> <event> <cart> <slide> <a> <b>*CCCC     reliable, numbered
                    ~<n> <t_us> <cart> <slide> <adc> [<adc> <adc> <adc>] <flags>*CCCC     lossy telemetry
                    ?<why>*CCCC     a bad line was seen

* Fields are separated by single spaces. Numbers are decimal integers without leading zeros or plus sign. A word has
  letters, digits and `. _ -`.
* The host sends a request again until it is answered. A command whose sequence number and text are the same as of one
  of the last {answers_kept} commands gets the same answer and does not run again; `HELLO` forgets old answers. Verbs
  that only ask, and `HELLO` and `HB`, run each time they come.
* A line that is too long, has no checksum or a wrong one, or does not have this form is not taken, and the board says
  so. Empty lines are ignored. After noise both sides go on at the next newline.
* Events are numbered from 0 since the board's start; the last {events_kept} are kept, and `EVENTS` sends them again.
  The answer to `HB` holds the number of the next event, so the loss of the newest one shows too.
* `t_us` counts microseconds since the board's start modulo 2^32: it wraps after 71.6 minutes.
* Positions are steps; in telemetry they are in 1/{position_fraction} step, the fraction being how far the timer is
  through the present step, less a half: the middle of a step is where the position is exactly its count.
"""

_AGAIN = " Runs each time it comes."


def render(protocol: dict[str, Any]) -> str:
    """The document's text, Markdown."""
    limits = {limit["name"]: limit["value"] for limit in protocol["limit"]}
    lines = [
        "# The serial protocol",
        "",
        f"`{protocol['name']}` version {protocol['version']}, hash `{protocol['hash']}`.",
        "Generated from `protocol.toml` by `generate.py`; do not edit.",
        "",
        "## Lines",
        "",
        FRAMING.format_map(limits),
        "## Verbs",
        "",
    ]
    for verb in protocol["verb"]:
        lines += _verb(verb)
    lines += ["## Errors", "", "| error | meaning |", "|---|---|"]
    lines += [f"| `{error['name']}` | {error['text']} |" for error in protocol["error"]]
    lines += ["", "## Events", "", "| event | a | b | meaning |", "|---|---|---|---|"]
    lines += [f"| `{e['name']}` | {e['a'] or '-'} | {e['b'] or '-'} | {e['text']} |" for e in protocol["event"]]
    lines += ["", "## Flags", "", "| bit | flag | meaning |", "|---|---|---|"]
    lines += [f"| {flag['bit']} | `{flag['name']}` | {flag['text']} |" for flag in protocol["flag"]]
    for values in protocol["values"]:
        lines += ["", f"## {values['name'].replace('-', ' ').capitalize()}", "", values["text"], ""]
        lines += ["| number | name | meaning |", "|---|---|---|"]
        lines += [f"| {member['number']} | `{member['name']}` | {member['text']} |" for member in values["members"]]
    lines += ["", "## Limits", "", "| name | value | unit | meaning |", "|---|---|---|---|"]
    lines += [f"| `{i['name']}` | {i['value']} | {i['unit'] or '-'} | {i['text']} |" for i in protocol["limit"]]
    lines += ["", "## Axes", "", "| number | axis | rate | acceleration |", "|---|---|---|---|"]
    lines += [
        f"| {axis['number']} | {axis['name']} | {axis['default_rate_msteps_s'] / 1000:g} steps/s "
        f"| {axis['default_acceleration_steps_s2']} steps/s² |"
        for axis in protocol["axis"]
    ]
    return "\n".join([*lines, ""])


def _verb(verb: dict[str, Any]) -> list[str]:
    call = " ".join([verb["name"], *(f"<{argument['name']}>" for argument in verb["arguments"])])
    lines = [
        f"### `{call}`",
        "",
        verb["text"] + ("" if verb["session"] else " Possible before HELLO.") + _AGAIN * verb["again"],
        "",
    ]
    if verb["arguments"]:
        lines += ["| argument | lowest | highest | unit | meaning |", "|---|---|---|---|---|"]
        lines += [
            f"| `{a['name']}` | {a['low']} | {a['high']} | {a.get('unit', '') or '-'} | {a['text']} |"
            for a in verb["arguments"]
        ]
        lines.append("")
    if verb["answers"]:
        lines += ["| answer | unit | meaning |", "|---|---|---|"]
        lines += [
            f"| `{a['name']}` | {a.get('unit', '') or ('word' if a.get('word') else '-')} | {a['text']} |"
            for a in verb["answers"]
        ]
        lines.append("")
    return lines
