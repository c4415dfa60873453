"""`users`: who is known to the service, in which role, by which token."""

from enum import StrEnum
from typing import Annotated
from urllib.parse import quote

import typer

from calrig.cli.exit_status import ASK_IT, Listed
from calrig.cli.options import Db, Json, Server
from calrig.cli.running_service import client_at, open_store

app = typer.Typer(
    cls=Listed,
    help="Manage users and their roles, in the store or at a running service.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
Name = Annotated[str, typer.Argument(metavar="NAME", help="Letters, digits and . _ @ + -")]


class RoleName(StrEnum):
    """Each may what those before it may."""

    viewer = "viewer"
    operator = "operator"
    releaser = "releaser"
    admin = "admin"


Role = Annotated[
    RoleName,
    typer.Option(
        "--role",
        help="viewer: looks, stops a stage; operator: runs, imports, diagnoses, notes; releaser: accepts, "
        "releases, voids; admin: users and limits.",
    ),
]


@app.command("add")
def add(
    name: Name,
    role: Role = RoleName.viewer,
    token: Annotated[
        bool, typer.Option("--token/--no-token", help="Without one: known by a trusted proxy alone.")
    ] = True,
    db: Db = None,
    server: Server = None,
) -> None:
    """Add a user and print the token, which is shown this once."""
    if server:
        from calrig.client.transport import part

        body = {"name": name, "role": role.value, "token": token}
        made = part(client_at(server).post("/api/users", body), "token")
    else:
        with open_store(db, "users", or_ask=ASK_IT) as store:
            _, made = store.users.add(name, role.value, with_token=token)
    if made is not None:
        typer.echo(made)


@app.command("token")
def token(name: Name, db: Db = None, server: Server = None) -> None:
    """Give a user a new token and print it; the one before is revoked."""
    if server:
        from calrig.client.transport import part

        made = part(client_at(server).post(f"{_path(name)}/token", {}), "token")
    else:
        with open_store(db, "users", or_ask=ASK_IT) as store:
            _, made = store.users.new_token(name)
    typer.echo(made)


@app.command("role")
def role(
    name: Name,
    role: Annotated[RoleName, typer.Argument(metavar="ROLE", help="viewer, operator, releaser or admin.")],
    db: Db = None,
    server: Server = None,
) -> None:
    """Give a user another role."""
    if server:
        client_at(server).post(f"{_path(name)}/role", {"role": role.value})
    else:
        with open_store(db, "users", or_ask=ASK_IT) as store:
            store.users.set_role(name, role.value)


@app.command("disable")
def disable(name: Name, db: Db = None, server: Server = None) -> None:
    """Disable a user's token and logins; what they did stays theirs."""
    if server:
        client_at(server).post(f"{_path(name)}/disable", {})
    else:
        with open_store(db, "users", or_ask=ASK_IT) as store:
            store.users.disable(name)


@app.command("list")
def list_(as_json: Json = False, db: Db = None, server: Server = None) -> None:
    """List everybody who is known, or was."""
    from calrig.cli.output import print_users, show
    from calrig.model.service import KnownUser

    if server:
        from calrig.client.documents import each

        users = each(KnownUser, client_at(server).get("/api/users"))
    else:
        with open_store(db) as store:
            users = [KnownUser.model_validate(user) for user in store.users.all()]
    show(users, print_users, as_json=as_json)


def _path(name: str) -> str:
    return f"/api/users/{quote(name, safe='')}"
