"""``twinline doctor``: what it looks at, and what it says when something is wrong."""

import asyncio
import json
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from tests.integration.command_line import twinline
from tests.integration.scan_bench import ScanBench, on_machine
from twinline.devices.virtual_time import run_virtual
from twinline.machines import real_board, real_camera
from twinline.operations.doctor import check_board, check_camera, check_computer
from twinline.operations.passes.preflight import Check, Grade
from twinline.settings import Settings


def looked_at(settings: Settings) -> dict[str, Check]:
    return {check.name: check for check in check_computer(settings)}


def test_this_computer_is_fit_for_scanning(tmp_path: Path) -> None:
    checks = looked_at(Settings(data_dir=tmp_path / "data", port=0))
    assert {"python", "packages", "kernels", "panel", "disk", "port", "serial ports", "video devices"} <= set(checks)
    assert [check.name for check in checks.values() if check.grade is Grade.FAILED] == []
    assert all(check.detail.endswith(".") for check in checks.values())
    # Looking leaves nothing behind.
    assert not list(tmp_path.iterdir())


def test_a_port_that_is_taken_is_noted(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        check = looked_at(Settings(data_dir=tmp_path, host="127.0.0.1", port=port))["port"]
    assert check.grade is Grade.WARNING
    assert f"127.0.0.1:{port} is taken" in check.detail


def test_a_data_folder_that_cannot_be_written_has_failed(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    check = looked_at(Settings(data_dir=tmp_path / "file" / "data", port=0))["disk"]
    assert check.grade is Grade.FAILED


def check_both(bench: ScanBench) -> "asyncio.Future[tuple[Check, Check]]":
    machine = bench.simulated.machine

    async def look() -> tuple[Check, Check]:
        return await check_board(machine.board), await check_camera(machine.camera)

    return asyncio.ensure_future(look())


def test_board_and_camera_are_described(tmp_path: Path) -> None:
    board, camera = on_machine(tmp_path / "scan", check_both)
    assert (board.grade, camera.grade) == (Grade.GOOD, Grade.GOOD)
    assert "simulated, firmware simulated-1" in board.detail
    assert "lines of telemetry" in board.detail
    assert "640 x 360 px jpeg, 25" in camera.detail
    assert "exposure" in camera.detail


def test_a_latched_board_is_noted(tmp_path: Path) -> None:
    async def look(bench: ScanBench) -> Check:
        bench.simulated.board.faults = replace(bench.simulated.board.faults, e_stop=True)
        return await check_board(bench.simulated.machine.board)

    check = on_machine(tmp_path / "scan", look)
    assert check.grade is Grade.WARNING
    assert "latched (e stop): reset it" in check.detail


def test_what_is_not_there_has_failed_with_the_reason(tmp_path: Path) -> None:
    async def look() -> tuple[Check, Check]:
        missing = tmp_path / "missing"
        return await check_board(real_board(str(missing))), await check_camera(real_camera(str(missing)))

    board, camera = run_virtual(look())
    assert (board.grade, camera.grade) == (Grade.FAILED, Grade.FAILED)
    assert "missing" in board.detail
    assert "missing" in camera.detail


def test_a_camera_that_sends_nothing_has_failed(tmp_path: Path) -> None:
    async def look(bench: ScanBench) -> Check:
        await bench.simulated.machine.camera.open()
        bench.simulated.camera.faults = replace(bench.simulated.camera.faults, gone=True)
        return await check_camera(bench.simulated.machine.camera)

    check = on_machine(tmp_path / "scan", look)
    assert check.grade is Grade.FAILED
    assert "cable is out" in check.detail


@pytest.mark.parametrize("json_", [False, True])
def test_the_command_says_all_and_fails_if_anything_did(tmp_path: Path, json_: bool) -> None:
    done = twinline("doctor", "--board", tmp_path / "missing", *(["--json"] if json_ else []))
    assert done.returncode == 1
    assert done.stderr == ""
    if json_:
        checks = json.loads(done.stdout)
        assert {check["grade"] for check in checks} <= {"good", "warning", "failed"}
        assert [check["name"] for check in checks if check["grade"] == "failed"] == ["board"]
    else:
        assert "FAILED  board: " in done.stdout
        assert "ok  python: " in done.stdout
