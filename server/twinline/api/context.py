"""What the routes work with; the composition root puts it into the application's state."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Request

import twinline
from twinline.api.models import (
    CaptureOut,
    ChangeOut,
    JobOut,
    LimitsOut,
    ScanOut,
    SceneOut,
    SnapshotOut,
    SystemOut,
    ViewOut,
)
from twinline.operations.captures import CaptureRecord
from twinline.operations.clock import rfc3339
from twinline.operations.display import DisplayState
from twinline.operations.feed import Change
from twinline.operations.jobs import Job
from twinline.operations.scans import Scan
from twinline.operations.workshop import Everything, Workshop


@dataclass(frozen=True)
class ApiContext:
    """The workshop and what the API says of the server around it."""

    workshop: Workshop
    upload_max_bytes: int
    data_dir: Path
    started_at: datetime

    def system(self) -> SystemOut:
        """The server itself."""
        toolbox = self.workshop.toolbox
        return SystemOut(
            name="Twinline",
            version=twinline.__version__,
            started_at=rfc3339(self.started_at),
            simulated=True,
            workers=self.workshop.workers.workers,
            methods=list(toolbox.methods),
            default_method=toolbox.default_method,
            sources=["laser1", "laser2"],
            scenes=[SceneOut(name=name, title=title) for name, title in toolbox.scenes.items()],
            limits=LimitsOut(upload_bytes=self.upload_max_bytes),
            data_dir=str(self.data_dir),
        )

    def scan(self, scan: Scan) -> ScanOut:
        """The JSON of a scan."""
        return ScanOut.of(scan, self.workshop.scans.files(scan.id))

    def snapshot(self, seq: int, everything: Everything) -> SnapshotOut:
        """The JSON of everything."""
        return SnapshotOut(
            seq=seq,
            system=self.system(),
            jobs=[JobOut.of(job) for job in everything.jobs],
            captures=[CaptureOut.of(record) for record in everything.captures],
            scans=[self.scan(scan) for scan in everything.scans],
            view=ViewOut.of(everything.view),
        )

    def change(self, change: Change) -> ChangeOut:
        """The JSON of a change."""
        return ChangeOut(
            seq=change.seq, topic=change.topic, action=change.action, id=change.id, item=self._item(change.item)
        )

    def _item(self, item: object) -> JobOut | CaptureOut | ScanOut | ViewOut | None:
        match item:
            case Job():
                return JobOut.of(item)
            case CaptureRecord():
                return CaptureOut.of(item)
            case Scan():
                return self.scan(item)
            case DisplayState():
                return ViewOut.of(item)
            case _:
                return None


def context_of(request: Request) -> ApiContext:
    """The context of the application that serves a request."""
    context = request.app.state.context
    assert isinstance(context, ApiContext)
    return context


def workshop_of(request: Request) -> Workshop:
    """The workshop of the application that serves a request."""
    return context_of(request).workshop


InContext = Annotated[ApiContext, Depends(context_of)]
InWorkshop = Annotated[Workshop, Depends(workshop_of)]
