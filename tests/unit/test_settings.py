from pathlib import Path

import pytest

from twinline.errors import SettingsError
from twinline.settings import Settings, is_loopback, load_settings


def test_without_anything_it_listens_on_this_machine_only() -> None:
    settings = load_settings(environment={})
    assert (settings.host, settings.port) == ("127.0.0.1", 8080)
    assert settings.data_dir.is_absolute()
    assert settings.worker_count >= 1


def test_arguments_win_over_the_environment_and_that_over_the_file(tmp_path: Path) -> None:
    file = tmp_path / "twinline.toml"
    file.write_text('port = 1\nworkers = 1\nhost = "localhost"\n')
    settings = load_settings(file, environment={"TWINLINE_PORT": "2", "TWINLINE_WORKERS": "2"}, port=3, workers=None)
    assert (settings.port, settings.workers, settings.host) == (3, 2, "localhost")


def test_all_mistakes_are_reported_together_with_their_place(tmp_path: Path) -> None:
    file = tmp_path / "twinline.toml"
    file.write_text('colour = "red"\nhost = "0.0.0.0"\n')
    with pytest.raises(SettingsError) as raised:
        load_settings(file, environment={"TWINLINE_PORT": "many", "TWINLINE_SPEED": "3"}, workers=-1)
    detail = raised.value.detail
    for part in (f"{file}, colour: there is no such setting", f"{file}, host:", "TWINLINE_PORT:", "TWINLINE_SPEED:"):
        assert part in detail
    assert "option workers:" in detail
    assert "0.0.0.0" in detail


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "::", "scanner.local", ""])
def test_an_address_that_others_can_reach_is_refused_with_the_reason(host: str) -> None:
    with pytest.raises(SettingsError, match="no login yet"):
        load_settings(environment={}, host=host)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.1.2.3", "::1", "localhost", "LOCALHOST"])
def test_addresses_of_this_machine_are_taken(host: str) -> None:
    assert is_loopback(host)
    assert load_settings(environment={}, host=host).host == host


@pytest.mark.parametrize(("text", "word"), [("port = ", "not valid TOML"), (None, "does not exist"), (b"\xff", "read")])
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, text: str | bytes | None, word: str) -> None:
    file = tmp_path / "twinline.toml"
    if isinstance(text, bytes):
        file.write_bytes(text)
    elif text is not None:
        file.write_text(text)
    with pytest.raises(SettingsError, match=word) as raised:
        load_settings(file, environment={})
    assert str(file) in raised.value.detail


def test_a_file_in_the_present_folder_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "twinline.toml").write_text("port = 8123\n")
    monkeypatch.chdir(tmp_path)
    assert load_settings(environment={}).port == 8123


def test_settings_do_not_read_the_environment_by_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWINLINE_PORT", "9")
    assert Settings().port == 8080
