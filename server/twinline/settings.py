"""What the person who runs the server may choose, and from where it is read."""

import ipaddress
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import platformdirs
from pydantic import Field, ValidationError, field_validator
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from twinline.errors import SettingsError

ENVIRONMENT_PREFIX = "TWINLINE_"
NOT_SETTINGS = frozenset({"TWINLINE_DATA", "TWINLINE_CHROMIUM"})
"""Variables that the tests read: where captures and the browser are."""
SETTINGS_FILE = "twinline.toml"


def _data_dir() -> Path:
    return platformdirs.user_data_path("twinline")


class Settings(BaseSettings):
    """Settings of one server; the defaults start it on the simulated scanner.

    Attributes
    ----------
    host
        Address to listen on; only this machine's own, since there is no login.
    port
        TCP port; 0 lets the system choose a free one.
    data_dir
        Folder for captures, jobs and scans.
    workers
        Worker processes for reconstruction; 0 means one per processor core.
    upload_max_bytes
        Largest accepted request body.
    unpacked_max_bytes
        Largest total size of the files in an uploaded zip.
    unpacked_max_files
        Largest number of files in an uploaded zip.
    view_max_points
        Points that the 3-D view shows before it thins them.
    """

    model_config = SettingsConfigDict(
        env_prefix=ENVIRONMENT_PREFIX, env_ignore_empty=True, extra="forbid", frozen=True, validate_default=True
    )

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8080
    data_dir: Path = Field(default_factory=_data_dir)
    workers: Annotated[int, Field(ge=0, le=256)] = 0
    upload_max_bytes: Annotated[int, Field(ge=1)] = 4 * 2**30
    unpacked_max_bytes: Annotated[int, Field(ge=1)] = 16 * 2**30
    unpacked_max_files: Annotated[int, Field(ge=1)] = 100_000
    view_max_points: Annotated[int, Field(ge=1000)] = 5_000_000

    @field_validator("host")
    @classmethod
    def _only_this_machine(cls, host: str) -> str:
        if not is_loopback(host):
            raise ValueError(
                f"{host!r} can be reached from other machines, and this version has no login yet; "
                "use 127.0.0.1, ::1 or localhost (for another machine, an SSH tunnel)"
            )
        return host

    @field_validator("data_dir")
    @classmethod
    def _absolute(cls, data_dir: Path) -> Path:
        return data_dir.expanduser().absolute()

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Take values from arguments only; `load_settings` merges the file and the environment itself."""
        return (init_settings,)

    @property
    def worker_count(self) -> int:
        """Number of worker processes, with 0 resolved to the processor's cores."""
        return self.workers or os.cpu_count() or 1


def is_loopback(host: str) -> bool:
    """Whether a host name or address can only be this machine.

    Parameters
    ----------
    host
        ``localhost`` or a numeric address without brackets and port.
    """
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def load_settings(
    file: Path | None = None, *, environment: Mapping[str, str] | None = None, **overrides: Any
) -> Settings:
    """Read the settings: arguments win over the environment, and that over the file.

    Parameters
    ----------
    file
        A TOML file that must exist; without it ``twinline.toml`` of the current folder is used if there is one.
    environment
        Variables to read, by default the process's own.
    overrides
        Values from the command line; None means not given.

    Raises
    ------
    SettingsError
        With every mistake in one message: unknown names, wrong values, an unreadable file.
    """
    environment = os.environ if environment is None else environment
    origins: dict[str, str] = {}
    values: dict[str, Any] = {}
    for name, value in _read_file(file).items():
        values[name], origins[name] = value, f"{file or SETTINGS_FILE}, {name}"
    for variable, text in environment.items():
        if variable.upper().startswith(ENVIRONMENT_PREFIX) and variable.upper() not in NOT_SETTINGS and text:
            name = variable[len(ENVIRONMENT_PREFIX) :].lower()
            values[name], origins[name] = text, variable
    for name, value in overrides.items():
        if value is not None:
            values[name], origins[name] = value, f"option {name}"
    try:
        return Settings(**values)
    except ValidationError as error:
        mistakes = [_mistake(dict(problem), origins) for problem in error.errors()]
        raise SettingsError("; ".join(mistakes) + ".") from None


def _read_file(file: Path | None) -> dict[str, Any]:
    path = file or Path(SETTINGS_FILE)
    if file is None and not path.is_file():
        return {}
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise SettingsError(f"The settings file {path} does not exist.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"The settings file {path} cannot be read: {error}.") from error
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"The settings file {path} is not valid TOML: {error}.") from error


def _mistake(problem: Mapping[str, Any], origins: Mapping[str, str]) -> str:
    name = ".".join(str(part) for part in problem["loc"])
    where = origins.get(str(problem["loc"][0]) if problem["loc"] else "", name)
    if problem["type"] == "extra_forbidden":
        known = ", ".join(sorted(Settings.model_fields))
        return f"{where}: there is no such setting (known: {known})"
    message = str(problem["msg"]).removeprefix("Value error, ")
    return f"{where}: {message[:1].lower()}{message[1:]}"
