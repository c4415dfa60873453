"""calrig: calibrates IMU attitude sensors on a rotary stage and traces what is left of the error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from calrig.client import AsyncClient, Client
    from calrig.loaded import Calibration

__version__ = "0.1.0"
__all__ = ["AsyncClient", "Client", "__version__", "load"]


def __getattr__(name: str) -> Any:
    """The clients of a running service, imported where they are used."""
    if name in {"AsyncClient", "Client"}:
        from calrig import client

        return getattr(client, name)
    raise AttributeError(f"module 'calrig' has no attribute {name!r}")


def load(source: str | Path) -> Calibration:
    """A unit's calibration, ready to be applied, from a file or an address.

    `calrig.load("as-0042.json").elevation_deg(12.3, temperature_c=24.0)`; `calrig.loaded.Calibration` has the
    rest. What applies it is imported here: the package's own import stays light.
    """
    from calrig.loaded import load as loaded

    return loaded(source)
