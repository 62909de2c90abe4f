"""In CI a skipped test is a failed one."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.architecture.checkout import ROOT

TESTS = {
    "a test that skips": "import pytest\n\ndef test_it():\n    pytest.skip('no data')\n",
    "a marked test": "import pytest\n\n@pytest.mark.skip(reason='no data')\ndef test_it(): ...\n",
    "a whole module": "import pytest\n\npytest.skip('no data', allow_module_level=True)\n",
}


def run_pytest(folder: Path, test: str, *options: str, ci: str) -> subprocess.CompletedProcess[str]:
    """Run one test file under the project's own conftest."""
    shutil.copy(ROOT / "tests" / "conftest.py", folder / "conftest.py")
    (folder / "test_sample.py").write_text(test, encoding="utf-8")
    (folder / "pytest.ini").write_text("[pytest]\n", encoding="utf-8")
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, folder],
        env={**os.environ, "CI": ci},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )


@pytest.mark.parametrize("kind", TESTS)
def test_a_skip_fails_the_run_in_ci(kind: str, tmp_path: Path) -> None:
    done = run_pytest(tmp_path, TESTS[kind], ci="true")
    assert done.returncode != 0
    assert "no data" in done.stdout


def test_a_skip_in_ci_is_let_through_by_an_explicit_flag(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, TESTS["a test that skips"], "--allow-skips", ci="true")
    assert done.returncode == 0, done.stdout


def test_a_skip_outside_ci_is_only_a_skip(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, TESTS["a test that skips"], ci="")
    assert done.returncode == 0, done.stdout


def test_a_test_that_is_expected_to_fail_is_not_a_skip(tmp_path: Path) -> None:
    test = "import pytest\n\n@pytest.mark.xfail(reason='known')\ndef test_it():\n    assert False\n"
    done = run_pytest(tmp_path, test, ci="true")
    assert "1 xfailed" in done.stdout
