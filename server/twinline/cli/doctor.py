"""``twinline doctor``."""

import asyncio
import json as json_text
from dataclasses import asdict

import typer

from twinline.machines import real_board, real_camera
from twinline.operations.doctor import check_board, check_camera, check_computer
from twinline.operations.passes.preflight import Check, Grade
from twinline.settings import load_settings

_SIGNS = {Grade.GOOD: "ok", Grade.WARNING: "note", Grade.FAILED: "FAILED"}


def run_doctor(board: str | None, camera: str | None, *, json: bool) -> None:
    """Look at this computer, and at a board and a camera where they are named; exit status 1 if anything failed."""
    checks: list[Check] = []

    def tell(check: Check) -> None:
        checks.append(check)
        if not json:
            typer.echo(f"{_SIGNS[check.grade]:>6}  {check.name}: {check.detail}")

    for check in check_computer(load_settings()):
        tell(check)
    if board is not None:
        tell(asyncio.run(check_board(real_board(board))))
    if camera is not None:
        tell(asyncio.run(check_camera(real_camera(camera))))
    if json:
        typer.echo(json_text.dumps([asdict(check) for check in checks], indent=1))
    if any(check.grade is Grade.FAILED for check in checks):
        raise typer.Exit(1)
