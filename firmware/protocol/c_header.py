"""The protocol as a C header: constants, and X-macro tables from which the core builds its own."""

from typing import Any


def render(protocol: dict[str, Any]) -> str:
    """The header's text."""
    lines = [
        "/* Generated from protocol.toml by generate.py; do not edit. */",
        "#ifndef TWINLINE_PROTOCOL_GEN_H",
        "#define TWINLINE_PROTOCOL_GEN_H",
        "",
        f'#define PROTOCOL_NAME "{protocol["name"]}"',
        f"#define PROTOCOL_VERSION {protocol['version']}",
        f'#define PROTOCOL_HASH "{protocol["hash"]}"',
        "",
    ]
    for limit in protocol["limit"]:
        lines += [f"/* {limit['text']} */", f"#define PROTOCOL_{_upper(limit['name'])} {limit['value']}"]
    lines.append("")
    for axis in protocol["axis"]:
        for key in ("number", "default_rate_msteps_s", "default_acceleration_steps_s2"):
            lines.append(f"#define AXIS_{_upper(axis['name'])}_{_upper(key)} {axis[key]}")
    lines += [
        "",
        "/* X(verb, needs session, runs each time it comes, number of arguments) */",
        "#define PROTOCOL_VERBS(X) \\",
    ]
    lines += _rows(
        [f"X({v['name']}, {int(v['session'])}, {int(v['again'])}, {len(v['arguments'])})" for v in protocol["verb"]]
    )
    lines += ["", "/* X(verb, position of the argument, lowest, highest) */", "#define PROTOCOL_ARGUMENTS(X) \\"]
    lines += _rows(
        [
            f"X({verb['name']}, {position}, {argument['low']}, {_number(argument['high'])})"
            for verb in protocol["verb"]
            for position, argument in enumerate(verb["arguments"])
        ]
    )
    for table, kind in (("ERRORS", "error"), ("EVENTS", "event")):
        lines += ["", "/* X(name, text on the wire) */", f"#define PROTOCOL_{table}(X) \\"]
        lines += _rows([f'X({_upper(entry["name"])}, "{entry["name"]}")' for entry in protocol[kind]])
    lines.append("")
    for flag in protocol["flag"]:
        lines.append(f"#define FLAG_{_upper(flag['name'])} (1u << {flag['bit']})")
    for values in protocol["values"]:
        lines += ["", f"/* {values['text']} */"]
        for member in values["members"]:
            lines.append(f"#define {_upper(values['name'])}_{_upper(member['name'])} {member['number']}")
    return "\n".join([*lines, "", "#endif"]) + "\n"


def _rows(rows: list[str]) -> list[str]:
    return [f"    {row} \\" for row in rows[:-1]] + [f"    {rows[-1]}"]


def _number(value: int) -> str:
    return f"{value}u" if value > 2**31 - 1 else str(value)


def _upper(name: str) -> str:
    return name.upper().replace("-", "_")
