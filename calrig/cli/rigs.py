"""`rigs`: what is configured, and what answers on the ports of this machine."""

from __future__ import annotations

from typing import Annotated

import typer

from calrig.cli.options import Config


def rigs(
    scan: Annotated[
        bool,
        typer.Option(
            "--scan",
            help="Also list the devices that answer on the ports; opening a port resets most boards.",
        ),
    ] = False,
    config: Config = None,
) -> None:
    """List the configured rigs and, with --scan, the devices that answer; nothing is moved."""
    from calrig.cli import output
    from calrig.settings import load_settings

    settings = load_settings(config)
    output.print_rigs(settings.rig)
    if scan:
        from calrig.instruments import scan as ports
        from calrig.instruments.scan_stanza import stanza

        found = ports.scan(settings.ports())
        output.print_ports(found, stanza(found, {rig.name for rig in settings.rig}))
