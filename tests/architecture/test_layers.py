"""Arrows point down, and mathematics does no input or output."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.architecture.checkout import PACKAGE, ROOT, relative

PURE_PACKAGES = ("geometry", "stripe", "fusion", "calibration")
PURE_LIBRARIES = frozenset({"cv2", "numba", "numpy", "scipy", "twinline"})
IMPURE_STANDARD_LIBRARY = frozenset(
    {"asyncio", "concurrent", "ctypes", "datetime", "fileinput", "glob", "http", "importlib", "io", "logging"}
    | {"mmap", "multiprocessing", "os", "pathlib", "pickle", "pkgutil", "queue", "random", "runpy", "secrets"}
    | {"select", "shelve", "shutil", "signal", "socket", "sqlite3", "ssl", "subprocess", "sys", "tempfile"}
    | {"threading", "time", "urllib", "uuid", "webbrowser", "zipfile"}
)
IMPURE_BUILTINS = frozenset({"input", "open", "print"})
IMPURE_ATTRIBUTES = frozenset(
    {"VideoCapture", "VideoWriter", "fromfile", "genfromtxt", "imread", "imshow", "imwrite", "loadtxt", "memmap"}
    | {"savetxt", "savez", "savez_compressed", "tofile", "loadmat", "savemat"}
)


def imported_libraries(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and top-level name of every import, wherever it stands."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, name.name.partition(".")[0]) for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.lineno, node.module.partition(".")[0]


def impurities(source: str) -> Iterator[tuple[int, str]]:
    """Line and name of everything that a package of pure mathematics may not use."""
    tree = ast.parse(source)
    for line, library in imported_libraries(tree):
        from_outside = library not in PURE_LIBRARIES and library not in sys.stdlib_module_names
        if from_outside or library in IMPURE_STANDARD_LIBRARY:
            yield line, library
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in IMPURE_BUILTINS:
            yield node.lineno, node.func.id
        elif isinstance(node, ast.Attribute) and node.attr in IMPURE_ATTRIBUTES:
            yield node.lineno, node.attr


def test_the_layers_hold() -> None:
    linter = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [linter, "--no-logo", "--no-cache"], cwd=ROOT, capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("package", PURE_PACKAGES)
def test_mathematics_does_no_input_or_output(package: str) -> None:
    found = [
        f"{relative(path)}:{line}: {name}"
        for path in sorted((PACKAGE / package).rglob("*.py"))
        for line, name in impurities(path.read_text(encoding="utf-8"))
    ]
    assert not found, f"{package} may compute, and nothing else:\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("source", "name"),
    [
        ("import pandas", "pandas"),
        ("def f():\n    from time import monotonic", "time"),
        ("import logging.handlers", "logging"),
        ("open('rig.json')", "open"),
        ("import cv2\ncv2.imread('frame.png')", "imread"),
    ],
)
def test_input_and_output_is_noticed(source: str, name: str) -> None:
    assert name in [found for _, found in impurities(source)]


def test_plain_mathematics_is_let_through() -> None:
    assert not list(impurities("import math\nimport numpy as np\nfrom twinline.errors import RigError\nnp.eye(3)"))
