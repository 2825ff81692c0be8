"""Commands that consist of subcommands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Choice:
    """Command that runs the subcommand that was chosen."""

    what: Any

    def run(self, command_line: str) -> None:
        """Run the subcommand."""
        self.what.run(command_line)
