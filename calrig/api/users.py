"""Users, as an admin keeps them: who is known, in which role, by which token."""

# No `from __future__ import annotations`: pydantic reads the annotations of the classes.

from typing import Annotated

from fastapi import APIRouter
from pydantic import Field

from calrig.api.access import Who, requires
from calrig.api.context import Context
from calrig.api.errors import problems
from calrig.api.login import Auth
from calrig.api.models import Body
from calrig.model.service import KnownUser, Role
from calrig.store.users import NAME, User

router = APIRouter(tags=["access"], dependencies=[requires("admin")])


class NewUser(Body):
    """Somebody to be known."""

    name: Annotated[str, Field(pattern=rf"^{NAME.pattern}$")]
    role: Role = "viewer"
    token: bool = Field(default=True, description="False for who comes in by a trusted proxy alone.")


class NewRole(Body):
    """What somebody may do from now on."""

    role: Role


class UserWithToken(KnownUser):
    """The same, and the token, which is told here and never again."""

    token: str | None


@router.get("/api/users", response_model=list[KnownUser], summary="Everybody who is known, or was")
def list_users(context: Context) -> list[User]:
    """By name. For admins, as all that is about users."""
    return context.store.users()


@router.post(
    "/api/users",
    status_code=201,
    response_model=UserWithToken,
    responses=problems(409, 413, 422),
    summary="Add a user",
)
def add_user(body: NewUser, context: Context, auth: Auth, who: Who) -> object:
    """With a token, shown this once: the store keeps its hash. Who was disabled is added again likewise."""
    user, token = context.store.add_user(body.name, body.role, with_token=body.token, who=who)
    auth.people.reread()
    return _with_token(user, token)


@router.post(
    "/api/users/{name}/token",
    response_model=UserWithToken,
    responses=problems(404, 409),
    summary="Give a user a new token",
)
def new_token(name: str, context: Context, auth: Auth, who: Who) -> object:
    """In place of the one before, which opens nothing from then on, nor does a session begun with it."""
    user, token = context.store.new_token(name, who=who)
    auth.people.reread()
    return _with_token(user, token)


@router.post(
    "/api/users/{name}/role",
    response_model=KnownUser,
    responses=problems(404, 409, 413, 422),
    summary="Give a user another role",
)
def set_role(name: str, body: NewRole, context: Context, auth: Auth, who: Who) -> object:
    """From now on, also where they have logged in. The last admin stays one."""
    user = context.store.set_role(name, body.role, who=who)
    auth.people.reread()
    return user


@router.post(
    "/api/users/{name}/disable",
    response_model=KnownUser,
    responses=problems(404, 409),
    summary="Let a user in no more",
)
def disable_user(name: str, context: Context, auth: Auth, who: Who) -> object:
    """Token and sessions open nothing any more. What they did stays theirs; the last admin stays."""
    user = context.store.disable_user(name, who=who)
    auth.people.reread()
    return user


def _with_token(user: User, token: str | None) -> UserWithToken:
    return UserWithToken(**KnownUser.model_validate(user).model_dump(), token=token)
