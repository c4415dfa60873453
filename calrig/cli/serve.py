"""`serve`: the web page and the API until a signal ends them."""

from __future__ import annotations

from contextlib import AbstractContextManager, ExitStack, closing, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import calrig
from calrig.cli.input_files import in_utf8
from calrig.cli.options import Config, Db, LogFormat, Record
from calrig.cli.start import loaded

if TYPE_CHECKING:
    import socket

    from calrig.api.access import Access
    from calrig.runs.services import Service
    from calrig.settings import Settings


HERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 (told to commands on this machine)
"""Where a service that listens everywhere is asked from its own machine."""


def serve(
    host: Annotated[str, typer.Option(metavar="H", help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="Port; 0: any free one.")] = 8000,
    record: Record = None,
    log_format: LogFormat = None,
    db: Db = None,
    config: Config = None,
) -> None:
    """Serve the web page and the API, with a simulated rig when none is configured.

    With a PostgreSQL --db it is a centre, whose rigs are those of its benches (`calrig agent`).

    CALRIG_TOKEN is the token that clients have to send; without one, only this machine is served.
    """
    from calrig.api.access import access_here
    from calrig.api.server import address_of, listen
    from calrig.logs import configure_log
    from calrig.settings import load_settings, store_url

    settings = load_settings(config)
    configure_log(log_format)
    access = access_here(host, address_of(host, port), settings)
    with closing(listen(host, port)) as listener:
        _serve_on(listener, access, settings, store_url(db), record)


def _serve_on(
    listener: socket.socket, access: Access, settings: Settings, url: str, record: Path | None
) -> None:
    from calrig.api.app import create_app, what_is_asked
    from calrig.api.server import Server
    from calrig.cli.local_service import centre_service, local_service
    from calrig.store.engines import is_centre, shown

    serving: AbstractContextManager[Service] = (
        centre_service(url, settings)
        if is_centre(url)
        else local_service(url, "serve", settings.rig, settings, record)
    )
    with serving as service, suppress(KeyboardInterrupt), ExitStack() as stack:
        if settings.keep_samples_days is not None:
            service.store.samples.prune(datetime.now(UTC) - timedelta(days=settings.keep_samples_days))

        if settings.webhook is not None:
            from calrig.runs.webhook import Webhook

            hook = stack.enter_context(closing(Webhook(service, settings.webhook)))
            hook.start()

        kept_in = str(settings.file) if settings.limit else None
        app = create_app(
            service,
            access=access,
            limits_kept_in=kept_in,
            interval_days=settings.interval_days,
            centre=settings.centre,
            laboratory=settings.laboratory,
        )

        def say_ready() -> None:
            rigs = ", ".join(f"{r.name} (simulated)" if r.simulated else r.name for r in service.rigs())
            host, port = listener.getsockname()[:2]
            service.store.answers_at(url_of(HERE.get(host, host), port))
            where = f"{url_of(host, port)}, store {in_utf8(shown(url))}"
            typer.echo(f"calrig {calrig.__version__} at {where}, rigs: {rigs}{what_is_asked(app)}")

        loaded()
        # On SIGINT and SIGTERM uvicorn stops in order, then raises what it was told by.
        Server(app, say_ready).run(sockets=[listener])


def url_of(host: str, port: int) -> str:
    """The address of a service, of which `host` may be one of IPv6."""
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
