"""The commands' options as the layers below take them."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.unit.reconstruction.small_pass import Pass, write_pass
from twinline.cli.commands import main
from twinline.cli.reconstruct import ReconstructRequest, choose_rig
from twinline.cli.stripes import StripesRequest, flag_names
from twinline.errors import InputError, StripeError
from twinline.geometry.noise import NoiseModel
from twinline.recording.capture import open_capture
from twinline.recording.rig_file import write_rig
from twinline.stripe.model import Flag

STRIPES = StripesRequest(
    (Path("a.png"),), Path("a.csv"), "maximum-likelihood", "auto", "auto", "auto", None, None, None, False
)
RECONSTRUCT = ReconstructRequest(
    Path("capture"), Path("a.ply"), None, "gaussian", "red", frozenset({"laser2"}), 3, False, None, False
)


def test_a_noise_model_is_read_in_the_order_read_noise_electrons_speckle() -> None:
    assert replace(STRIPES, noise="1.5,inf,0.2").settings().noise == NoiseModel(1.5, math.inf, 0.2)
    assert STRIPES.settings().noise is None


@pytest.mark.parametrize("noise", ["", "1", "1,2", "1,2,3,4", "a,b,c", "1;2;3"])
def test_a_noise_model_of_another_form_is_refused(noise: str) -> None:
    with pytest.raises(InputError, match="n,K,C"):
        replace(STRIPES, noise=noise).settings()


@pytest.mark.parametrize("change", [{"runs": "along"}, {"lasers": "0"}, {"lasers": "two"}])
def test_unknown_directions_and_numbers_are_refused(change: dict[str, str]) -> None:
    with pytest.raises(InputError, match="choose"):
        replace(STRIPES, **change).settings()  # type: ignore[arg-type]


def test_flags_are_written_as_words() -> None:
    assert flag_names(0) == ""
    assert flag_names(int(Flag.SATURATED | Flag.NEAR_EDGE)) == "saturated|near-edge"
    assert all(flag_names(int(flag)) == (flag.name or "").lower().replace("_", "-") for flag in Flag)


def test_reconstruction_options_carry_the_choices() -> None:
    options = RECONSTRUCT.options()
    assert (options.method, options.channel, options.every) == ("gaussian", "red", 3)
    assert options.sources == {"laser2"}


def test_unknown_methods_and_no_sources_are_refused() -> None:
    with pytest.raises(StripeError, match="steger"):
        replace(RECONSTRUCT, method="centroid").options()
    with pytest.raises(InputError, match="--sources"):
        replace(RECONSTRUCT, sources=frozenset()).options()


def test_a_given_rig_comes_before_the_folder_s_own_and_that_before_the_nominal_one(tmp_path: Path) -> None:
    capture = open_capture(write_pass(tmp_path / "capture", Pass().with_frames(1)))
    assert choose_rig(capture, None).name == "small pass"
    for name, path in (("own", capture.path / "rig.json"), ("given", tmp_path / "rig.json")):
        write_rig(path, replace(capture.rig(), name=name))
    assert choose_rig(capture, None).name == "own"
    assert choose_rig(capture, tmp_path / "rig.json").name == "given"


def test_the_version_is_printed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["twinline", "--version"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("twinline ")


def test_an_error_becomes_one_line_and_exit_status_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "argv", ["twinline", "rig", str(tmp_path / "none"), "-o", str(tmp_path / "rig.json")])
    monkeypatch.setenv("OPENCV_LOG_LEVEL", "OFF")
    monkeypatch.setenv("OPENCV_FFMPEG_LOGLEVEL", "-8")
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("twinline: ")
    assert said.err.count("\n") == 1
