"""Every dependency is pinned, and the pins carry no address."""

import re
import tomllib

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.architecture.checkout import ROOT

CONSTRAINTS = ROOT / "server" / "constraints.txt"


def pins() -> list[Requirement]:
    """The constraints as requirements."""
    lines = CONSTRAINTS.read_text(encoding="utf-8").splitlines()
    return [Requirement(line) for line in lines if line and not line.startswith("#")]


def test_every_dependency_is_pinned_to_a_version_that_the_project_allows() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    named = project["project"]["dependencies"] + project["project"]["optional-dependencies"]["dev"]
    wanted = [Requirement(text) for text in [*named, *project["build-system"]["requires"]]]
    versions: dict[str, list[str]] = {}
    for pin in pins():
        versions.setdefault(canonicalize_name(pin.name), []).extend(spec.version for spec in pin.specifier)
    wrong = [
        str(requirement)
        for requirement in wanted
        if not (found := versions.get(canonicalize_name(requirement.name)))
        or not all(requirement.specifier.contains(version) for version in found)
    ]
    assert not wrong, f"server/constraints.txt lacks, or contradicts: {wrong}; its first lines say how to make it anew"


def test_a_pin_is_one_exact_version_and_no_address() -> None:
    loose = [str(pin) for pin in pins() if pin.url or not re.fullmatch(r"==[^*,]+", str(pin.specifier))]
    assert not loose
