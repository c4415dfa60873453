"""Logging in on the page, where the service asks for a token; programs send theirs with each request."""

from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from pydantic import Field

from calrig.api.authentication import Door
from calrig.api.errors import problems
from calrig.api.models import Answer, Body

router = APIRouter(tags=["access"])


class Login(Body):
    """What is typed in."""

    token: Annotated[str, Field(max_length=1000)]


class LoginAnswer(Answer):
    """Whether a token is asked for, and whether whoever asks has logged in."""

    needed: bool
    logged_in: bool


def _door(request: Request) -> Door:
    door: Door = request.app.state.door
    return door


TheDoor = Annotated[Door, Depends(_door)]


@router.get("/api/login", summary="Whether to log in")
async def login_state(request: Request, door: TheDoor) -> LoginAnswer:
    """Open to everybody, so that the page knows what to show."""
    return LoginAnswer(needed=door.access.token is not None, logged_in=door.has_session(request))


@router.post("/api/login", responses=problems(413, 422), summary="Log in on the page")
async def log_in(body: Login, request: Request, response: Response, door: TheDoor) -> LoginAnswer:
    """Sets a cookie that lasts twelve hours. A wrong token is 401, a second later."""
    if door.access.token is None:
        return LoginAnswer(needed=False, logged_in=False)
    await door.check_token(request, body.token)
    door.set_cookie(request, response)
    return LoginAnswer(needed=True, logged_in=True)


@router.post("/api/logout", summary="Log out on the page")
async def log_out(request: Request, response: Response, door: TheDoor) -> LoginAnswer:
    """Ends the session whose cookie came along."""
    door.drop_cookie(request, response)
    return LoginAnswer(needed=door.access.token is not None, logged_in=False)
