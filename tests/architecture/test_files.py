"""What every file of the checkout keeps to, whatever is written in it."""

import re

import pytest

from tests.architecture.checkout import checkout_files, code_files, relative, text_files

MOST_LINES = 500
GENERATED = frozenset({"web/src/api/schema.ts"})
BANNED_NAMES = frozenset({"base", "common", "helper", "helpers", "manager", "managers", "misc", "util", "utils"})
FORBIDDEN = {
    "a path of somebody's machine": re.compile(r"(?<![\w.:*/-])/(?:root|tmp|work|Users/\w+)/\w"),
    "the address of a package registry": re.compile(
        r"\bpypi\.org|\bpythonhosted\.org|\bregistry\.(?:npmjs|yarnpkg)\b|\bcrates\.io|\bghcr\.io|\bproxy\.golang\.org"
    ),
    "unfinished work": re.compile(r"\b(?:TO[D]O|FIX[M]E|XX[X])\b"),
    "the number of an issue": re.compile(r"\b(?:issue|closes|fixes|resolves) #?\d", re.IGNORECASE),
    "a merge conflict": re.compile(r"^(?:<{7} |>{7} )", re.MULTILINE),
}


def forbidden_lines(text: str) -> list[tuple[int, str]]:
    """Line numbers of what may not be in a tracked file, and what it is."""
    return [
        (text.count("\n", 0, match.start()) + 1, what)
        for what, pattern in FORBIDDEN.items()
        for match in pattern.finditer(text)
    ]


def banned_parts(path: str) -> set[str]:
    """The words of a path, with its folders, that say nothing about what is inside."""
    return set(re.split(r"[/._-]", path.lower())) & BANNED_NAMES


def test_no_file_is_longer_than_a_reader_can_hold() -> None:
    lengths = {relative(path): path.read_bytes().count(b"\n") for path in code_files()}
    long = {name: lines for name, lines in lengths.items() if lines > MOST_LINES and name not in GENERATED}
    assert not long, f"over {MOST_LINES} lines; where is the seam? {long}"


def test_every_module_is_named_after_what_is_in_it() -> None:
    modules = [relative(path) for path in code_files() if path.suffix != ".css"]
    banned = [name for name in modules if banned_parts(name)]
    assert not banned, f"named after nothing ({', '.join(sorted(BANNED_NAMES))}): {banned}"


def test_no_file_holds_what_belongs_to_one_machine_or_one_day() -> None:
    found = [
        f"{relative(path)}:{line}: {what}"
        for path, text in text_files().items()
        for line, what in forbidden_lines(text)
    ]
    assert not found, "\n".join(found)


def test_every_text_file_ends_its_lines_the_same_way() -> None:
    wrong = [relative(path) for path, text in text_files().items() if "\r" in text or (text and text[-1] != "\n")]
    assert not wrong, f"carriage returns, or no newline at the end: {wrong}"


def test_no_large_file_is_kept() -> None:
    large = {relative(path): path.stat().st_size for path in checkout_files() if path.stat().st_size > 1_000_000}
    assert not large, f"over 1 MB: {large}"


# The bars keep these lines from being found themselves.
@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("data = '/wo|rk/data'", "a path of somebody's machine"),
        ("https://files.pythonhos|ted.org/x.whl", "the address of a package registry"),
        ("x = 1  # TO|DO: think", "unfinished work"),
        ("Fixes #|12", "the number of an issue"),
        ("a\n<<<<|<<< HEAD\n", "a merge conflict"),
    ],
)
def test_forbidden_text_is_noticed(text: str, what: str) -> None:
    assert [found for _, found in forbidden_lines(text.replace("|", ""))] == [what]


@pytest.mark.parametrize(
    ("path", "banned"),
    [("server/x_utils.py", {"utils"}), ("web/src/common/a.ts", {"common"}), ("server/baseline.py", set())],
)
def test_empty_names_are_noticed(path: str, banned: set[str]) -> None:
    assert banned_parts(path) == banned
