"""GRBL 1.1."""

from collections.abc import Sequence

from calrig.instruments.device import Identity, Probe, StageDevice, opened_by
from calrig.instruments.stages.grbl.protocol import (
    BANNER,
    BAUDRATE,
    SETTING,
    VERSION,
    is_report_before_1_1,
    parse_report,
)
from calrig.instruments.stages.grbl.settings import general_warnings


def _matches(line: str) -> bool:
    own = (BANNER, VERSION, SETTING)
    return any(form.fullmatch(line) for form in own) or bool(parse_report(line) or is_report_before_1_1(line))


def _identity(lines: Sequence[str]) -> Identity:
    names = [banner[1] for line in lines if (banner := BANNER.fullmatch(line))]
    versions = [version for line in lines if (version := VERSION.fullmatch(line))]
    names += [f"Grbl {version[1]}{version[2] or ''}" for version in versions]
    states = [f", in {report.state}" for line in lines if (report := parse_report(line))]
    states += [", older than the 1.1 that calrig speaks" for line in lines if is_report_before_1_1(line)]
    settings = {int(found[1]): float(found[2]) for line in lines if (found := SETTING.fullmatch(line))}
    warnings = [f". {warning.removesuffix('.')}" for warning in general_warnings(settings)]
    return Identity((names or ["Grbl"])[0] + (states or [""])[-1] + "".join(warnings))


DEVICE = StageDevice(
    driver="grbl",
    title="an Arduino with a stepper shield and GRBL 1.1, a rotary table on one of its axes",
    baudrate=BAUDRATE,
    opens=opened_by(f"{__name__}.driver"),
    probes=(
        Probe(
            BAUDRATE,
            0.4,
            b"?",
            harmless="asks for its status, told even while it moves; to all others it is no command",
        ),
    ),
    matches=_matches,
    identity=_identity,
    version_query=b"$I\n$$\n",
)
