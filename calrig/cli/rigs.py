"""`rigs`: what there is, and what answers on the ports of its machine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from calrig.cli.local_service import require_drivers
from calrig.cli.options import Config, Db, Json, Server
from calrig.cli.running_service import running_service

if TYPE_CHECKING:
    from calrig.client import Client
    from calrig.settings import RigSettings


def rigs(
    scan: Annotated[
        bool,
        typer.Option(
            "--scan",
            help="Also list the devices that answer on the ports; opening a port resets most boards.",
        ),
    ] = False,
    as_json: Json = False,
    config: Config = None,
    db: Db = None,
    server: Server = None,
) -> None:
    """List the rigs and, with --scan, the devices that answer; nothing is moved.

    Those of the service that holds the store, where one does; else those that are configured.
    """
    from calrig.cli import output

    there = None if config else running_service(server, db)
    shown = _there(there, scan) if there is not None else _here(config, scan)
    if as_json:
        output.print_json(shown)
        return
    (output.print_rigs if there is None else output.print_rigs_there)(shown["rigs"])
    if scan:
        output.print_ports(shown["found"], shown["stanza"])


def _there(client: Client, scan: bool) -> dict[str, Any]:
    from calrig.client.transport import part

    shown: dict[str, Any] = {"rigs": [rig.model_dump(mode="json") for rig in client.rigs()]}
    if scan:
        looked = client.post("/api/rigs/scan", {})
        shown.update({name: part(looked, name) for name in ("found", "stanza")})
    return shown


def _here(config: str | None, scan: bool) -> dict[str, Any]:
    from calrig.settings import load_settings

    settings = load_settings(config)
    require_drivers(settings, settings.rig)
    shown: dict[str, Any] = {"rigs": [_configured(rig) for rig in settings.rig]}
    if scan:
        from dataclasses import asdict

        from calrig.instruments import scan as ports
        from calrig.instruments.scan import stanza

        found = ports.scan(settings.ports())
        known = {rig.name for rig in settings.rig}
        shown.update(found=[asdict(one) for one in found], stanza=stanza(found, known))
    return shown


def _configured(rig: RigSettings) -> dict[str, Any]:
    """A rig as it is configured; what is simulated has no driver and no port that could be told."""
    is_simulated = rig.simulated is not None
    parts = {
        name: None if is_simulated or part is None else {"driver": part.driver, "port": part.port}
        for name, part in (("stage", rig.stage), ("imu", rig.imu))
    }
    return {"name": rig.name, "limits_deg": list(rig.limits_deg), "simulated": is_simulated, **parts}
