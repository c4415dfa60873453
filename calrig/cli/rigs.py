"""`rigs`: what there is, and what answers on the ports of its machine."""

from __future__ import annotations

from typing import Annotated

import typer

from calrig.cli.options import Config, Db, Server
from calrig.cli.running_service import running_service


def rigs(
    scan: Annotated[
        bool,
        typer.Option(
            "--scan",
            help="Also list the devices that answer on the ports; opening a port resets most boards.",
        ),
    ] = False,
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
        from calrig.client.transport import part

        output.print_rigs_there(there.rigs())
        if scan:
            looked = there.post("/api/rigs/scan", {})
            output.print_ports(part(looked, "found"), part(looked, "stanza"))
        return

    from calrig.settings import load_settings

    settings = load_settings(config)
    output.print_rigs(settings.rig)
    if scan:
        from dataclasses import asdict

        from calrig.instruments import scan as ports
        from calrig.instruments.scan_stanza import stanza

        found = ports.scan(settings.ports())
        output.print_ports([asdict(one) for one in found], stanza(found, {rig.name for rig in settings.rig}))
