"""What all tests share: real data, the browser, reproducible examples, and no silent skipping in CI."""

import os
import shutil
from collections.abc import Callable, Generator
from pathlib import Path

import hypothesis
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--allow-skips",
        action="store_true",
        help="let a test be skipped where CI=true would make it a failure",
    )


def pytest_configure() -> None:
    # Derandomized examples are the same in every run; a deadline would assert wall-clock time.
    hypothesis.settings.register_profile("reproducible", derandomize=True, deadline=None, database=None)
    hypothesis.settings.load_profile("reproducible")


def fail_if_skipped(report: pytest.TestReport | pytest.CollectReport, config: pytest.Config) -> None:
    """Turn a skip into a failure in CI: what is skipped there is never run anywhere."""
    in_ci = os.environ.get("CI", "").lower() in {"1", "true", "yes"}
    expected_to_fail = hasattr(report, "wasxfail")
    if not in_ci or not report.skipped or expected_to_fail or config.getoption("--allow-skips"):
        return
    reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
    report.outcome = "failed"
    report.longrepr = f"{reason}\nIn CI no test may be skipped; --allow-skips makes an exception."


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    fail_if_skipped(report, item.config)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    fail_if_skipped(report, collector.config)
    return report


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    """The event loop of every asynchronous test."""
    return "asyncio"


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """A function that gives the path of a data set of real captures, or skips the test where it is absent.

    They stand in ``../shared/data`` beside the checkout, or where the environment's ``TWINLINE_DATA`` says.
    """
    root = Path(os.environ.get("TWINLINE_DATA") or REPOSITORY.parent / "shared" / "data")

    def find(name: str) -> Path:
        path = root / name
        if not path.exists():
            pytest.skip(f"the data set {name} is not in {root} (set TWINLINE_DATA to the folder that holds it)")
        return path

    return find


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of the Chromium that browser tests drive; skips the test where there is none."""
    path = shutil.which(os.environ.get("TWINLINE_CHROMIUM") or "chromium")
    if path is None:
        pytest.skip("Chromium is not installed (./dev test installs it where it may, or set TWINLINE_CHROMIUM)")
    return path
