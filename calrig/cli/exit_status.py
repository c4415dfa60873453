"""How a command ends: 0 done; 1 the work failed; 2 wrong usage or unreadable input; one line says why."""

import errno
import sys
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from calrig.errors import printable

WHOLE = 1000


class Listed(TyperGroup):
    """A group of commands with whole summaries, on as many lines as they take."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Writes the list of commands into the help."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl([(name, c.get_short_help_str(WHOLE)) for name, c in commands if c is not None])


NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""Of a disk; what writes files of its own says which."""
STATUS = {
    "calrig.errors.WorkError": 1,
    "calrig.errors.InputError": 2,
    "calrig.settings.SettingsError": 2,
    "calrig.store.errors.AddressOfNoStoreError": 2,
    "calrig.store.errors.StoreError": 1,
    "calrig.analysis.errors.RunsError": 1,
    "calrig.analysis.errors.Invalid": 2,
    "calrig.api.server.AddressError": 1,
    "calrig.api.access.AccessError": 2,
}
"""Exit status by kind of error; by name, for importing them all would take a second to say one line."""
ASK_IT = "ask it by --server http://HOST:PORT"


class Commands(Listed):
    """The commands: what a user can cause ends in one line on standard error, never in a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Carries a command out."""
        try:
            done = super().invoke(ctx)
            sys.stdout.flush()
            return done
        except KeyboardInterrupt as left:
            _leave("; ".join(["interrupted", *getattr(left, "__notes__", [])]), 1)
        except OSError as error:
            if error.errno not in NO_ROOM:
                raise
            _leave(f"standard output takes no more ({error.strerror})", 1)
        except Exception as error:
            status = _exit_status(error)
            if status is None:
                raise
            _leave(f"{error}{self._or_ask(ctx, error)}", status)

    def _or_ask(self, ctx: Any, error: Exception) -> str:
        """What else helps where a service holds the store that a command with `--server` wants to write."""
        command = self.get_command(ctx, ctx.invoked_subcommand or "")
        may_ask = command is not None and any(option.name == "server" for option in command.params)
        return f", or {ASK_IT}" if may_ask and getattr(error, "is_served", False) else ""


def _leave(reason: str, status: int) -> NoReturn:
    typer.echo(f"calrig: {printable(' '.join(reason.split()))}", err=True)
    sys.exit(status)


def _exit_status(error: Exception) -> int | None:
    """The exit status that an error a user can cause stands for; None for a defect of calrig's own."""
    names = (f"{kind.__module__}.{kind.__name__}" for kind in type(error).__mro__)
    return next((STATUS[name] for name in names if name in STATUS), None)
