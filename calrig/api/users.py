"""Users, managed by an admin: name, role and token."""

from typing import Annotated

from fastapi import APIRouter
from pydantic import Field

from calrig.api.access import Who, requires
from calrig.api.context import Context
from calrig.api.login import Auth
from calrig.api.models import Body
from calrig.api.routes import CHANGES, answers
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


@router.get("/api/users", **answers(list[KnownUser], "All users"))
def list_users(context: Context) -> list[User]:
    """By name, disabled users included."""
    return context.store.users.all()


@router.post("/api/users", **answers(UserWithToken, "Add a user", 409, 413, 422, status=201))
def add_user(body: NewUser, context: Context, auth: Auth, who: Who) -> object:
    """The token is shown only here: the store keeps its hash. A disabled user is added again in this way."""
    user, token = context.store.users.add(body.name, body.role, with_token=body.token, who=who)
    auth.people.reread()
    return _with_token(user, token)


@router.post("/api/users/{name}/token", **answers(UserWithToken, "Give a user a new token", 404, 409))
def new_token(name: str, context: Context, auth: Auth, who: Who) -> object:
    """The previous token and all logins made with it stop working."""
    user, token = context.store.users.new_token(name, who=who)
    auth.people.reread()
    return _with_token(user, token)


@router.post("/api/users/{name}/role", **answers(KnownUser, "Give a user another role", *CHANGES))
def set_role(name: str, body: NewRole, context: Context, auth: Auth, who: Who) -> object:
    """The role takes effect at once, also in sessions. The last admin keeps that role."""
    user = context.store.users.set_role(name, body.role, who=who)
    auth.people.reread()
    return user


@router.post("/api/users/{name}/disable", **answers(KnownUser, "Disable a user", 404, 409))
def disable_user(name: str, context: Context, auth: Auth, who: Who) -> object:
    """Token and sessions stop working. Past actions keep the name; the last admin cannot be disabled."""
    user = context.store.users.disable(name, who=who)
    auth.people.reread()
    return user


def _with_token(user: User, token: str | None) -> UserWithToken:
    return UserWithToken(**KnownUser.model_validate(user).model_dump(), token=token)
