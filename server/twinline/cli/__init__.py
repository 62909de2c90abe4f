"""The command line. Each command's module is imported when it runs: the server's libraries take seconds to load."""

from twinline.cli.commands import main

__all__ = ["main"]
