"""`rigs`: what there is, and what answers on the ports of its machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calrig.cli.local_service import require_drivers
from calrig.cli.options import Config, Db, Json, Server
from calrig.cli.running_service import running_service

if TYPE_CHECKING:
    from calrig.client import Client
    from calrig.settings import RigSettings, Settings


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
    if there is not None:
        shown: Sequence[object] = (states := there.rigs())
        found, stanza = _scanned_there(there) if scan else ([], "")
    else:
        from calrig.settings import load_settings

        settings = load_settings(config)
        require_drivers(settings, settings.rig)
        shown = [_configured(rig) for rig in settings.rig]
        found, stanza = _scanned(settings) if scan else ([], "")
    if as_json:
        output.print_json({"rigs": shown} | ({"found": found, "stanza": stanza} if scan else {}))
        return
    if there is not None:
        output.print_rigs_there(states)
    else:
        output.print_rigs(settings.rig)
    if scan:
        output.print_ports(found, stanza)


Found = tuple[Sequence[Mapping[str, Any]], str]
"""The devices that answer, and their stanza for calrig.toml."""


def _scanned_there(client: Client) -> Found:
    from calrig.client.transport import part

    looked = client.post("/api/rigs/scan", {})
    return part(looked, "found"), part(looked, "stanza")


def _scanned(settings: Settings) -> Found:
    from dataclasses import asdict

    from calrig.instruments import scan as ports
    from calrig.instruments.scan import stanza

    found = ports.scan(settings.ports())
    return [asdict(one) for one in found], stanza(found, {rig.name for rig in settings.rig})


def _configured(rig: RigSettings) -> Mapping[str, object]:
    """A rig as it is configured; a simulated one has no driver and no port to name."""
    is_simulated = rig.simulated is not None
    parts = {
        name: None if is_simulated or part is None else {"driver": part.driver, "port": part.port}
        for name, part in (("stage", rig.stage), ("imu", rig.imu))
    }
    return {"name": rig.name, "limits_deg": list(rig.limits_deg), "simulated": is_simulated, **parts}
