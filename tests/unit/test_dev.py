"""The script ./dev: what it says when it cannot go on, and when it installs again."""

import importlib.machinery
import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

DEV = Path(__file__).resolve().parents[2] / "dev"


@pytest.fixture
def dev(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module, working on an empty checkout."""
    loader = importlib.machinery.SourceFileLoader("dev", str(DEV))
    spec = importlib.util.spec_from_loader("dev", loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    loader.exec_module(module)
    for name in ("ROOT", "WEB", "CONSTRAINTS", "PANEL", "VENV", "PYTHON", "TWINLINE", "UV", "STAMP"):
        original: Path = getattr(module, name)
        monkeypatch.setattr(module, name, tmp_path / original.relative_to(DEV.parent))
    (tmp_path / "web" / "src").mkdir(parents=True)
    (tmp_path / "pyproject.toml").write_text("[project]\n", encoding="utf-8")
    return module


def test_it_uses_the_standard_library_only() -> None:
    script = f"import runpy; runpy.run_path({str(DEV)!r})"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", script], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def test_an_old_python_is_named_with_the_way_out(
    dev: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dev, "OLDEST_PYTHON", (99, 0))
    assert dev.main(["check"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("dev: Twinline needs Python 3.11 or newer")
    assert said.count("\n") == 1


def test_a_missing_venv_module_is_named_with_its_package(
    dev: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert dev.main(["run"]) == 1
    said = capsys.readouterr().err
    assert "no module venv" in said
    assert "python3-venv" in said
    assert said.count("\n") == 1


def test_a_missing_network_is_one_sentence(dev: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    script = "import sys; print('error: dns error: failed to lookup address information'); sys.exit(2)"
    with pytest.raises(dev.StopError, match=r"^No network while downloading uv"):
        dev.run_quietly([sys.executable, "-c", script], doing="downloading uv", cwd=DEV.parent)
    assert capsys.readouterr().err == ""


def test_any_other_failure_shows_what_the_tool_said(dev: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    script = "import sys; print('no matching version'); sys.exit(2)"
    with pytest.raises(dev.StopError, match=r"^Downloading uv failed \(exit status 2\)"):
        dev.run_quietly([sys.executable, "-c", script], doing="downloading uv", cwd=DEV.parent)
    assert "no matching version" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["pyproject.toml", "server/constraints.txt", "web/package.json", "web/src/a.ts"])
def test_what_the_installation_is_made_from_changes_its_digest(dev: ModuleType, name: str) -> None:
    before = dev.sources_digest()
    path: Path = dev.ROOT / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("changed\n", encoding="utf-8")
    assert dev.sources_digest() != before


@pytest.mark.parametrize("name", ["web/node_modules/a.js", "server/twinline/errors.py", "tests/test_a.py"])
def test_other_files_leave_the_installation_alone(dev: ModuleType, name: str) -> None:
    before = dev.sources_digest()
    path: Path = dev.ROOT / name
    path.parent.mkdir(parents=True)
    path.write_text("changed\n", encoding="utf-8")
    assert dev.sources_digest() == before


def test_a_missing_browser_stops_the_tests_unless_skips_are_allowed(
    dev: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dev.shutil, "which", lambda name: None)
    browser_tests: Path = dev.ROOT / "tests" / "browser"
    browser_tests.mkdir(parents=True)
    assert dev.get_browser(allow_skips=False) == {}
    (browser_tests / "test_page.py").touch()
    with pytest.raises(dev.StopError, match="install the package chromium"):
        dev.get_browser(allow_skips=False)
    assert dev.get_browser(allow_skips=True) == {}


def test_an_unknown_command_is_answered_with_the_known_ones(
    dev: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    assert dev.main(["frobnicate"]) == 1
    assert "run, test, check" in capsys.readouterr().err
