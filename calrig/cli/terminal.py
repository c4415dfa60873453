"""What the command line shows: a run's progress on standard error, tables on standard output."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn
from rich.table import Table
from rich.text import Text

from calrig.analysis.errors import Conflict
from calrig.errors import printable

if TYPE_CHECKING:
    from calrig.instruments.scan import Found
    from calrig.runs.service import RunService
    from calrig.settings import RigSettings
    from calrig.store import AT_REST, Event, Run

LOOK_S = 0.1
"""How often a run is looked at when nothing is heard of it, and how soon a Ctrl-C is seen."""


PERCENT = 100
"""Of a static log, which has no poses to be counted."""


def follow(service: RunService, run: Run) -> Run:
    """Shows a run's progress, on a terminal, until it has ended; Ctrl-C aborts it. Returns it as it ended."""
    columns = (
        TextColumn("unit {task.fields[unit]}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[elevation]}", markup=False),
        TextColumn("{task.fields[left]}", markup=False),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task(
            "", total=run.progress["poses_total"] or PERCENT, unit=run.unit, elevation="", left=""
        )
        with _stop_request() as asked:
            return _until_ended(service, run.id, asked, lambda event: _show(event, progress, bar))


class _Asked:
    """Whether a signal has asked for the end. A flag, for an exception can get lost in a finaliser."""

    def __init__(self) -> None:
        self.to_stop = False

    def __call__(self, number: int, _frame: object) -> None:
        self.to_stop = True
        signal.signal(number, signal.default_int_handler)  # the second one is not asked but told


@contextmanager
def _stop_request() -> Iterator[_Asked]:
    """Takes SIGINT and SIGTERM for as long as it lasts."""
    asked = _Asked()
    before = {number: signal.signal(number, asked) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _until_ended(service: RunService, run_id: str, asked: _Asked, show: Callable[[Event], None]) -> Run:
    """Shows the run's events until it has ended, aborting it once that is asked for."""
    news = threading.Event()
    unsubscribe = service.bus.subscribe(run_id, news.set)
    seen = 0
    aborted = False
    try:
        while True:
            news.clear()
            run = service.run(run_id)
            for event in service.store.events_after(run_id, seen):
                seen = event.seq
                show(event)
            if run.status in AT_REST:
                return run
            if asked.to_stop and not aborted:
                aborted = True
                with suppress(Conflict):  # it has just ended by itself
                    service.abort(run_id)
                continue
            news.wait(LOOK_S)
    finally:
        unsubscribe()


def _show(event: Event, progress: Progress, bar: TaskID) -> None:
    data = event.data
    if event.type == "progress":
        left_s = data["remaining_s"]
        left = "" if left_s is None else f"{int(left_s) // 60}:{int(left_s) % 60:02d} left"
        completed = data["poses_done"] if data["poses_total"] else PERCENT * data["fraction"]
        progress.update(bar, completed=completed, left=left)
    elif event.type == "reading" and data["stage_deg"] is not None:
        progress.update(bar, elevation=f"{data['stage_deg']:+.1f}°")


def print_result(run: Run) -> None:
    """Prints a run's result as a table."""
    console = Console(soft_wrap=True)
    if run.result is None:
        return
    table = Table(title=_text(f"run {run.id}: unit {run.unit} on {run.rig}"), title_justify="left")
    for heading in ("", "value", "± (noise)", "± (stage)"):
        table.add_column(heading, justify="right" if heading else "left")
    for row in _rows(run.result):
        table.add_row(*row)
    console.print(table)
    if run.verdict is not None:
        for sentence in run.verdict.says:
            console.print(_text(sentence))


def _rows(result: dict[str, Any]) -> Iterable[tuple[str, ...]]:
    gyro = result["gyro"]
    temperature = result["temperature_c"] or {"min": None, "max": None}
    stage = result["reference"] or {"bias_std_deg": None, "scale_std": None}
    bias = result["bias_deg"], result["bias_std_deg"], stage["bias_std_deg"]
    scale = result["scale"], result["scale_std"], stage["scale_std"]
    yield "bias", *(_number(value, "°") for value in bias)
    yield "scale", *(_number(value, "", 6) for value in scale)
    yield "RMS raw", _number(result["rms_raw_deg"], "°"), ""
    yield "RMS calibrated", _number(result["rms_calibrated_deg"], "°"), ""
    yield "noise of one reading", _number(result["noise_deg"], "°"), ""
    yield "poses", str(result["n_poses"]), ""
    lowest, highest = (_number(temperature[end], " °C", 1) for end in ("min", "max"))
    yield "temperature", f"{lowest} to {highest}", ""
    for axis, bias, std in zip("xyz", gyro["bias_dps"], gyro["bias_std_dps"], strict=True):
        yield f"gyro bias {axis}", _number(bias, " °/s"), _number(std, " °/s")
    yield "gyro scale", _number(gyro["scale"], "", 6), _number(gyro["scale_std"], "", 6)


def _text(text: str, style: str = "") -> Text:
    """Text as it is: no markup, no escape sequences."""
    return Text(printable(text), style)


def _number(value: float | None, unit: str, decimals: int = 4) -> str:
    return "not known" if value is None else f"{value:.{decimals}f}{unit}"


def print_rigs(rigs: Iterable[RigSettings]) -> None:
    """Prints the rigs that are configured."""
    table = Table()
    for heading in ("rig", "elevation", "stage", "imu"):
        table.add_column(heading)
    for rig in rigs:
        low, high = rig.limits_deg
        parts = [
            "simulated" if rig.simulated is not None or part is None else f"{part.driver} on {part.port}"
            for part in (rig.stage, rig.imu)
        ]
        table.add_row(rig.name, f"{low:g}° to {high:g}°", *(_text(part) for part in parts))
    Console(soft_wrap=True).print(table)


def print_ports(found: Sequence[Found], stanza: str) -> None:
    """Prints who answers on which port, and what can be pasted into the configuration."""
    console = Console(soft_wrap=True, highlight=False)
    if not found:
        console.print(_text("there is no serial port: is the USB cable plugged in?"))
        return
    table = Table()
    for heading in ("port", "what", "driver", "who", "USB", "serial number"):
        table.add_column(heading)
    for one in found:
        cells = (one.port, one.kind, one.driver, one.identity, one.usb_id, one.usb_serial)
        table.add_row(*(_text(cell or "") for cell in cells))
    console.print(table)
    if stanza:
        console.print(_text("for calrig.toml:\n"))
        console.print(_text(stanza), end="")


def print_diagnosis(found: dict[str, Any]) -> None:
    """Prints a diagnosis: verdict, each effect with parameters and evidence, the error before and after."""
    console = Console(soft_wrap=True, highlight=False)
    console.print(_text(f"{found['verdict']}: {found['final']['model']}", style="bold"))
    for effect in found["effects"]:
        rivals = f", or {', '.join(effect['confusable_with'])}" if effect["confusable_with"] else ""
        console.print(_text(f"\n{effect['name']}{rivals} ({effect['verdict']}; {effect['origin']})"))
        for name, parameter in effect["parameters"].items():
            if parameter is not None:
                std = "" if parameter["std"] is None else f" ± {parameter['std']:.2g}"
                console.print(_text(f"  {name} = {parameter['value']:.4g}{std}"))
        for sentence in (*effect["evidence"], effect["remedy"]):
            console.print(_text(f"  · {sentence}"))
    console.print()
    table = Table()
    for heading in ("RMS", "before", "after"):
        table.add_column(heading, justify="right" if heading != "RMS" else "left")
    for name, key in (("of the fit", "fit_rms_deg"), ("of poses not seen", "held_out_rms_deg")):
        table.add_row(name, _number(found["base"][key], "°"), _number(found["final"][key], "°"))
    table.add_row("noise floor", "", _number(found["noise"]["floor_deg"], "°"))
    console.print(table)
    for warning in found["warnings"]:
        console.print(_text(f"note: {warning}"))
    if found["follow_up"] is not None:
        apart = f"{found['follow_up']['separation_sigma']:.1f} standard errors"
        names = " from ".join(found["follow_up"]["separates"])
        console.print(
            _text(f"a follow-up run would separate {names} by {apart}: POST /api/runs/ID/follow-up")
        )


def print_gravity(found: dict[str, Any]) -> None:
    """Prints a calibration against gravity: what was found, and |a| less 1 g before and after."""
    console = Console(soft_wrap=True, highlight=False)
    names = [effect["name"] for effect in found["effects"]]
    console.print(_text(f"{found['verdict']}: {', '.join(['bias', 'scale', *names])}", style="bold"))
    for effect in found["effects"]:
        for name, parameter in effect["parameters"].items():
            std = "" if parameter["std"] is None else f" ± {parameter['std']:.2g}"
            console.print(_text(f"  {name} = {parameter['value']:.4g}{std}"))
    table = Table()
    for heading in (f"|a| − 1 g, {found['n_poses']} poses", "before", "after"):
        table.add_column(heading, justify="left" if heading.startswith("|") else "right")
    for name, key in (("of the fit", "fit_rms_mg"), (found["held_out"]["how"], "held_out_rms_mg")):
        table.add_row(name, _number(found["base"][key], " mg", 2), _number(found["final"][key], " mg", 2))
    console.print(table)
    for warning in found["warnings"]:
        console.print(_text(f"note: {warning}"))
