"""How a group lists its commands: each summary whole, where click cuts them after 45 letters."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup

WHOLE = 1000


class Listed(TyperGroup):
    """A group of commands with whole summaries, on as many lines as they take."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Writes the list of commands into the help."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl([(name, c.get_short_help_str(WHOLE)) for name, c in commands if c is not None])
