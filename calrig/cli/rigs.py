"""`rigs`: what is configured, and what answers on the ports of this machine."""

from __future__ import annotations

from typing import Annotated

import typer

from calrig.cli.options import Config


def rigs(
    scan: Annotated[
        bool, typer.Option("--scan", help="Also look who answers on every port; boards are reset by it.")
    ] = False,
    config: Config = None,
) -> None:
    """List the rigs that are configured and, with --scan, what answers on the ports; nothing is moved."""
    from calrig.cli import output
    from calrig.settings import load_settings

    settings = load_settings(config)
    output.print_rigs(settings.rig)
    if scan:
        from calrig.instruments import scan as ports
        from calrig.instruments.scan_stanza import stanza

        found = ports.scan(settings.ports())
        output.print_ports(found, stanza(found, {rig.name for rig in settings.rig}))
