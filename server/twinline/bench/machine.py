"""The machine that a run is measured on, as far as it matters: without names of hosts or users."""

import os
import platform
from importlib.metadata import version
from pathlib import Path

from twinline import __version__
from twinline.bench.figures import Machine

_LIBRARIES = ("numba", "numpy", "opencv-python-headless", "scipy")
_CACHES = Path("/sys/devices/system/cpu/cpu0/cache")
_USUAL_PRIVATE_BYTES = 2 * 2**20
_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30}


def this_machine() -> Machine:
    """Processor, cores, caches, system and versions."""
    versions = (("twinline", __version__), ("python", platform.python_version()))
    return Machine(
        processor=_processor(),
        cores=os.cpu_count() or 1,
        caches=tuple(f"L{level} {kind} {size}".replace(" unified", "") for level, kind, size, _ in _caches()),
        system=f"{platform.system()} {platform.machine()}",
        versions=(*versions, *((name, version(name)) for name in _LIBRARIES)),
    )


def private_cache_bytes() -> int:
    """Size of the largest cache that a core has to itself; a usual one where the system does not tell."""
    sizes = [_bytes(size) for _, kind, size, shared in _caches() if kind != "instruction" and not shared]
    return max(sizes, default=_USUAL_PRIVATE_BYTES)


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _caches() -> list[tuple[int, str, str, bool]]:
    """Level, kind, size and whether other cores share it, of each cache of the first core; none where unknown."""
    found = []
    for folder in sorted(_CACHES.glob("index*")) if _CACHES.is_dir() else []:
        try:
            level, kind, size, shared = (
                (folder / name).read_text().strip() for name in ("level", "type", "size", "shared_cpu_list")
            )
        except OSError:
            continue
        found.append((int(level), kind.lower(), size, "," in shared or "-" in shared))
    return found


def _bytes(size: str) -> int:
    return int(size[:-1]) * _UNITS[size[-1]] if size[-1] in _UNITS else int(size)
