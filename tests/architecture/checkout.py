"""The files of this checkout, as git would see them."""

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "server" / "twinline"
MADE_FOLDERS = frozenset(
    {".git", ".venv", "__pycache__", "node_modules", "dist", ".hypothesis"}
    | {".mypy_cache", ".pytest_cache", ".ruff_cache", ".import_linter_cache"}
)
CODE_SUFFIXES = frozenset({".c", ".css", ".h", ".js", ".mjs", ".py", ".sh", ".sql", ".ts", ".tsx"})


def checkout_files() -> list[Path]:
    """Every file that is tracked or could be: git's own answer, or a walk where there is no repository."""
    listed = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    if listed.returncode == 0 and (ROOT / ".git").exists():
        paths = [ROOT / name for name in listed.stdout.split("\0") if name]
    else:
        panel = PACKAGE / "api" / "panel"
        paths = [path for path in ROOT.rglob("*") if panel not in path.parents]
    return sorted(
        path for path in set(paths) if path.is_file() and not MADE_FOLDERS & set(path.relative_to(ROOT).parts)
    )


def code_files() -> list[Path]:
    """Those that people write code in."""
    return [path for path in checkout_files() if path.suffix in CODE_SUFFIXES or path == ROOT / "dev"]


def text_files() -> dict[Path, str]:
    """Those that are text, with what they say."""
    texts = {}
    for path in checkout_files():
        content = path.read_bytes()
        if b"\0" not in content:
            texts[path] = content.decode("utf-8", errors="replace")
    return texts


def relative(path: Path) -> str:
    """A path as it is written in messages."""
    return path.relative_to(ROOT).as_posix()
