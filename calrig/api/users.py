"""Logging in on the page, where the service asks for a token; and users, managed by an admin.

Programs send their token with each request.
"""

from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from pydantic import Field

from calrig.api.access import Caller, Who, caller_of
from calrig.api.authentication import Authentication
from calrig.api.body_limits import LOGIN_BYTES, LOGIN_PATH
from calrig.api.context import Context
from calrig.api.models import Body
from calrig.api.routes import CHANGES, answers, problems
from calrig.model.base import Model
from calrig.model.service import KnownUser, Role
from calrig.store.users import NAME, User

router = APIRouter(tags=["access"])


class Login(Body):
    """What is typed in."""

    token: Annotated[str, Field(max_length=1000)]


class LoginAnswer(Model):
    """Whether a login is needed, whether the caller is logged in, and as which user."""

    needed: bool
    logged_in: bool
    name: str | None = Field(description="Null where nobody is known by name.")
    role: Role | None = Field(description="What they may; null before they have shown who they are.")
    session: bool = Field(description="Whether they logged in here, and can log out.")


def _authentication(request: Request) -> Authentication:
    authentication: Authentication = request.app.state.authentication
    return authentication


Auth = Annotated[Authentication, Depends(_authentication)]


@router.get(LOGIN_PATH, summary="Whether to log in")
async def login_state(request: Request, auth: Auth) -> LoginAnswer:
    """Open to everybody, so that the page knows what to show."""
    return _login_answer(auth, caller_of(request), session=auth.has_session(request))


@router.post(
    LOGIN_PATH, max_body_size=LOGIN_BYTES, responses=problems(413, 422), summary="Log in on the page"
)
async def log_in(body: Login, request: Request, response: Response, auth: Auth) -> LoginAnswer:
    """Sets a cookie that lasts twelve hours. A wrong token is 401, a second later."""
    if not auth.asks:
        return _login_answer(auth, caller_of(request), session=False)
    await auth.check_token(request, body.token)
    auth.set_cookie(request, response, body.token)
    return _login_answer(auth, caller_of(request), session=True)


@router.post("/api/logout", summary="Log out on the page")
async def log_out(request: Request, response: Response, auth: Auth) -> LoginAnswer:
    """Ends the session whose cookie came along."""
    auth.drop_cookie(request, response)
    return _login_answer(auth, None, session=False)


def _login_answer(auth: Authentication, caller: Caller | None, *, session: bool) -> LoginAnswer:
    return LoginAnswer(
        needed=auth.asks,
        logged_in=auth.asks and caller is not None,
        name=caller and caller.name,
        role=caller and caller.role,
        session=session,
    )


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


@router.get("/api/users", **answers(list[KnownUser], "All users", role="admin"))
def list_users(context: Context) -> list[User]:
    """By name, disabled users included."""
    return context.store.users.all()


@router.post("/api/users", **answers(UserWithToken, "Add a user", 409, 413, 422, role="admin", status=201))
def add_user(body: NewUser, context: Context, auth: Auth, who: Who) -> object:
    """The token is shown only here: the store keeps its hash. A disabled user is added again in this way."""
    user, token = context.store.users.add(body.name, body.role, with_token=body.token, who=who)
    auth.people.reread()
    return _with_token(user, token)


@router.post(
    "/api/users/{name}/token", **answers(UserWithToken, "Give a user a new token", 404, 409, role="admin")
)
def new_token(name: str, context: Context, auth: Auth, who: Who) -> object:
    """The previous token and all logins made with it stop working."""
    user, token = context.store.users.new_token(name, who=who)
    auth.people.reread()
    return _with_token(user, token)


@router.post(
    "/api/users/{name}/role", **answers(KnownUser, "Give a user another role", *CHANGES, role="admin")
)
def set_role(name: str, body: NewRole, context: Context, auth: Auth, who: Who) -> object:
    """The role takes effect at once, also in sessions. The last admin keeps that role."""
    user = context.store.users.set_role(name, body.role, who=who)
    auth.people.reread()
    return user


@router.post("/api/users/{name}/disable", **answers(KnownUser, "Disable a user", 404, 409, role="admin"))
def disable_user(name: str, context: Context, auth: Auth, who: Who) -> object:
    """Token and sessions stop working. Past actions keep the name; the last admin cannot be disabled."""
    user = context.store.users.disable(name, who=who)
    auth.people.reread()
    return user


def _with_token(user: User, token: str | None) -> UserWithToken:
    return UserWithToken(**KnownUser.model_validate(user).model_dump(), token=token)
