"""The protocol's one source, and everything that is made from it."""

import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from twinline.devices.serial import protocol_gen

GENERATOR = Path(__file__).resolve().parents[2] / "firmware" / "protocol" / "generate.py"


@pytest.fixture(scope="module")
def generator() -> Iterator[ModuleType]:
    specification = importlib.util.spec_from_file_location("generate", GENERATOR)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    with pytest.MonkeyPatch.context() as patch:
        # As Python does for a script.
        patch.syspath_prepend(str(GENERATOR.parent))
        specification.loader.exec_module(module)
        yield module


def test_the_generated_files_are_up_to_date() -> None:
    check = subprocess.run([sys.executable, GENERATOR, "--check"], capture_output=True, encoding="utf-8", check=False)
    assert (check.returncode, check.stderr) == (0, "")


def test_the_hash_covers_the_protocol_and_not_its_texts(generator: ModuleType) -> None:
    protocol = generator.load()
    assert generator.digest(protocol) == protocol_gen.PROTOCOL_HASH
    protocol["verb"][0]["text"] = "Another wording."
    assert generator.digest(protocol) == protocol_gen.PROTOCOL_HASH
    protocol["verb"][0]["session"] = True
    assert generator.digest(protocol) != protocol_gen.PROTOCOL_HASH


def test_a_protocol_that_contradicts_itself_is_refused(generator: ModuleType) -> None:
    protocol = generator.load()
    protocol["flag"][1]["bit"] = protocol["flag"][0]["bit"]
    with pytest.raises(generator.ProtocolError, match="flag bit given twice"):
        generator.check(protocol)
    protocol = generator.load()
    protocol["verb"][3]["arguments"][0]["low"] = 99999
    with pytest.raises(generator.ProtocolError, match="HB deadline"):
        generator.check(protocol)


def test_the_header_and_the_module_agree(generator: ModuleType) -> None:
    header = GENERATOR.with_name("protocol_gen.h").read_text(encoding="utf-8")
    assert f'#define PROTOCOL_HASH "{protocol_gen.PROTOCOL_HASH}"' in header
    for flag in protocol_gen.Flag:
        assert f"#define FLAG_{flag.name} (1u << {flag.value.bit_length() - 1})" in header
    for verb, specification in protocol_gen.VERBS.items():
        assert (
            f"X({verb.name}, {int(specification.session)}, {int(specification.again)}, {len(specification.arguments)})"
        ) in header
