import errno
import os
import shutil
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Generator
from pathlib import Path

import pytest

from tests.unit.operations.exports.sample_clouds import PROVENANCE, random_cloud
from twinline.errors import OutputError
from twinline.fusion.cloud import PointCloud
from twinline.operations.exports.atomic import atomic_path
from twinline.operations.exports.glb import write_glb
from twinline.operations.exports.ply import write_ply
from twinline.operations.exports.provenance import Provenance

Writer = Callable[[Path, PointCloud, Provenance], None]
LARGE = random_cloud(100_000)


def test_the_file_appears_whole_when_the_block_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    with atomic_path(path) as temporary:
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".ply")
        temporary.write_text("new")
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_in_the_block_leaves_the_earlier_file(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text("old")

    def write_half() -> None:
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_file_may_be_read_by_whom_the_system_says(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with atomic_path(tmp_path / "a.ply"):
            pass
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.ply").stat().st_mode) == 0o640


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "real.ply").write_text("old")
    (tmp_path / "link.ply").symlink_to(tmp_path / "real.ply")
    with atomic_path(tmp_path / "link.ply") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "link.ply").is_symlink()
    assert (tmp_path / "real.ply").read_text() == "new"


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("absent/a.ply", "no such file or directory; make its folder first"),
        ("", "it is a folder; give a file name"),
        ("file/a.ply", "part of its path is a file"),
        ("x" * 300, "file name too long; choose a shorter name"),
    ],
)
def test_a_path_that_cannot_be_written_is_named_with_the_cause(tmp_path: Path, name: str, cause: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=f"cannot be written: .*{cause}") as raised, atomic_path(tmp_path / name):
        pass
    assert raised.value.detail.startswith(str(tmp_path / name))
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_devices_are_not_replaced_by_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OutputError, match="not an ordinary file"), atomic_path(tmp_path / "pipe"):
        pass
    assert (tmp_path / "pipe").is_fifo()


def test_a_folder_without_permission_is_an_error(tmp_path: Path) -> None:
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o555)
    if os.access(folder, os.W_OK):
        # The superuser may write anywhere, so somebody else has to try.
        folder.parent.chmod(0o755)
        code = (
            "import os, sys, pathlib\n"
            "from twinline.operations.exports.atomic import atomic_path\n"
            "os.setgid(65534); os.setuid(65534)\n"
            "with atomic_path(pathlib.Path(sys.argv[1])): pass\n"
        )
        for parent in tmp_path.parents[:2]:
            parent.chmod(parent.stat().st_mode | 0o011)
        done = run_python(code, str(folder / "a.ply"))
        assert "OutputError" in done.stderr
        assert "permission denied; choose a folder you may write to" in done.stderr
    else:
        with pytest.raises(OutputError, match="permission denied"), atomic_path(folder / "a.ply"):
            pass
    assert not list(folder.iterdir())


def run_python(code: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("write", [write_ply, write_glb])
def test_a_full_disk_is_an_error_and_leaves_the_earlier_file(small_disk: Path, write: Writer) -> None:
    path = small_disk / "cloud"
    write(path, random_cloud(10), PROVENANCE)
    before = path.read_bytes()
    with pytest.raises(OutputError, match="cloud cannot be written: no space left on device; free some space"):
        write(path, LARGE, PROVENANCE)
    assert path.read_bytes() == before
    assert list(small_disk.iterdir()) == [path]


@pytest.fixture
def small_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[Path]:
    """A file system of half a megabyte; where none can be mounted, a folder whose large files cannot be flushed."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = shutil.which("mount")
    options = ["-t", "tmpfs", "-o", "size=512k", "tmpfs", str(folder)]
    if mount and subprocess.run([mount, *options], capture_output=True, check=False).returncode == 0:
        try:
            yield folder
        finally:
            subprocess.run(["umount", str(folder)], check=True)
        return

    def flush(handle: int) -> None:
        if os.fstat(handle).st_size > 512 * 1024:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", flush)
    yield folder


@pytest.mark.parametrize("write", ["ply.write_ply", "glb.write_glb"])
def test_a_file_that_may_not_grow_is_an_error_and_leaves_nothing(tmp_path: Path, write: str) -> None:
    module, name = write.split(".")
    code = (
        "import resource, signal, sys, pathlib\n"
        f"from twinline.operations.exports.{module} import {name}\n"
        "from tests.unit.operations.exports.sample_clouds import PROVENANCE, random_cloud\n"
        f"signal.signal({int(signal.SIGXFSZ)}, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, 500_000))\n"
        f"{name}(pathlib.Path(sys.argv[1]), random_cloud(100_000), PROVENANCE)\n"
    )
    done = run_python(code, str(tmp_path / "cloud"))
    assert "OutputError" in done.stderr
    assert "cloud cannot be written: file too large" in done.stderr
    assert not list(tmp_path.iterdir())
