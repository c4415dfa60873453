"""Logging in on the page, where the service asks for a token; programs send theirs with each request."""

from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from pydantic import Field

from calrig.api.authentication import Authentication
from calrig.api.errors import problems
from calrig.api.limits import LOGIN_BYTES, LOGIN_PATH
from calrig.api.models import Answer, Body

router = APIRouter(tags=["access"])


class Login(Body):
    """What is typed in."""

    token: Annotated[str, Field(max_length=1000)]


class LoginAnswer(Answer):
    """Whether a token is asked for, and whether whoever asks has logged in."""

    needed: bool
    logged_in: bool


def _authentication(request: Request) -> Authentication:
    authentication: Authentication = request.app.state.authentication
    return authentication


Auth = Annotated[Authentication, Depends(_authentication)]


@router.get(LOGIN_PATH, summary="Whether to log in")
async def login_state(request: Request, auth: Auth) -> LoginAnswer:
    """Open to everybody, so that the page knows what to show."""
    return LoginAnswer(needed=auth.access.token is not None, logged_in=auth.has_session(request))


@router.post(
    LOGIN_PATH, max_body_size=LOGIN_BYTES, responses=problems(413, 422), summary="Log in on the page"
)
async def log_in(body: Login, request: Request, response: Response, auth: Auth) -> LoginAnswer:
    """Sets a cookie that lasts twelve hours. A wrong token is 401, a second later."""
    if auth.access.token is None:
        return LoginAnswer(needed=False, logged_in=False)
    await auth.check_token(request, body.token)
    auth.set_cookie(request, response)
    return LoginAnswer(needed=True, logged_in=True)


@router.post("/api/logout", summary="Log out on the page")
async def log_out(request: Request, response: Response, auth: Auth) -> LoginAnswer:
    """Ends the session whose cookie came along."""
    auth.drop_cookie(request, response)
    return LoginAnswer(needed=auth.access.token is not None, logged_in=False)
