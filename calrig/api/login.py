"""Logging in on the page, where the service asks for a token; programs send theirs with each request."""

from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from pydantic import Field

from calrig.api.access import Caller, caller_of
from calrig.api.authentication import Authentication
from calrig.api.body_limits import LOGIN_BYTES, LOGIN_PATH
from calrig.api.models import Body
from calrig.api.routes import problems
from calrig.model.base import Model
from calrig.model.service import Role

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
    return _answer(auth, caller_of(request), session=auth.has_session(request))


@router.post(
    LOGIN_PATH, max_body_size=LOGIN_BYTES, responses=problems(413, 422), summary="Log in on the page"
)
async def log_in(body: Login, request: Request, response: Response, auth: Auth) -> LoginAnswer:
    """Sets a cookie that lasts twelve hours. A wrong token is 401, a second later."""
    if not auth.asks:
        return _answer(auth, caller_of(request), session=False)
    await auth.check_token(request, body.token)
    auth.set_cookie(request, response, body.token)
    return _answer(auth, caller_of(request), session=True)


@router.post("/api/logout", summary="Log out on the page")
async def log_out(request: Request, response: Response, auth: Auth) -> LoginAnswer:
    """Ends the session whose cookie came along."""
    auth.drop_cookie(request, response)
    return _answer(auth, None, session=False)


def _answer(auth: Authentication, caller: Caller | None, *, session: bool) -> LoginAnswer:
    return LoginAnswer(
        needed=auth.asks,
        logged_in=auth.asks and caller is not None,
        name=caller and caller.name,
        role=caller and caller.role,
        session=session,
    )
