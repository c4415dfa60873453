"""The configuration: where it is looked for, and what it says of a file it cannot use."""

from __future__ import annotations

import hashlib
import re
from datetime import date
from pathlib import Path

import platformdirs
import pytest

from calrig.calibration.uncertainty.doubts import REMOUNT_LIMIT_DEG
from calrig.settings import DEMO_RIG, SettingsError, load_settings, packed, store_url

CONTRACT_EXAMPLE = """
[[rig]]
name = "bench-1"
limits_deg = [-90.0, 90.0]        # soft limits, of elevation
stage = { driver = "smc100", port = "/dev/ttyUSB0", axis = 1, zero_deg = 0.0, sign = 1, ratio = 1.0 }
imu = { driver = "calrig", port = "/dev/ttyACM0", baudrate = 115200 }
reference = { std_deg = 0.29, kind = "harmonic", certificate = "PTB 4711" }
"""


@pytest.fixture(autouse=True)
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A working directory and a user's configuration folder, both empty."""
    here, user = tmp_path / "here", tmp_path / "user"
    here.mkdir()
    user.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.delenv("CALRIG_CONFIG", raising=False)
    monkeypatch.delenv("CALRIG_DB", raising=False)
    monkeypatch.setattr(platformdirs, "user_config_path", lambda *_args, **_kwargs: user)
    return here, user


def rig(name: str, more: str = "") -> str:
    return (
        f'[[rig]]\nname = "{name}"\nstage = {{ driver = "smc100", port = "a" }}\n'
        f'imu = {{ driver = "calrig", port = "b" }}\n{more}\n'
    )


def written(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_the_contract_s_example_is_read_whole(tmp_path: Path) -> None:
    (bench,) = load_settings(written(tmp_path / "a.toml", CONTRACT_EXAMPLE)).rig
    assert bench.stage is not None
    assert bench.imu is not None
    assert bench.reference is not None
    assert (bench.name, bench.limits_deg) == ("bench-1", (-90.0, 90.0))
    assert (bench.stage.driver, bench.stage.port, bench.stage.axis) == ("smc100", "/dev/ttyUSB0", 1)
    assert (bench.stage.zero_deg, bench.stage.sign, bench.stage.ratio) == (0.0, 1, 1.0)
    assert (bench.imu.driver, bench.imu.port, bench.imu.baudrate) == ("calrig", "/dev/ttyACM0", 115200)
    assert (bench.reference.std_deg, bench.reference.kind) == (0.29, "harmonic")
    assert bench.reference.certificate == "PTB 4711"
    assert bench.simulated is None
    assert (bench.release, bench.remount_limit_deg) == ("auto", REMOUNT_LIMIT_DEG)


def test_without_a_configuration_there_is_the_demo_rig() -> None:
    assert load_settings().rig == (DEMO_RIG,)


def test_a_configuration_without_rigs_keeps_its_settings_and_has_the_demo_rig(tmp_path: Path) -> None:
    settings = load_settings(written(tmp_path / "a.toml", "keep_samples_days = 30"))
    assert settings.rig == (DEMO_RIG,)
    assert settings.keep_samples_days == 30


def test_the_nearest_configuration_is_taken(
    places: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, user = places

    def found(path: str | None = None) -> str:
        return load_settings(path).rig[0].name

    written(user / "calrig.toml", rig("of-the-user"))
    assert found() == "of-the-user"
    written(here / "calrig.toml", rig("of-the-directory"))
    assert found() == "of-the-directory"
    monkeypatch.setenv("CALRIG_CONFIG", written(tmp_path / "env.toml", rig("of-the-variable")))
    assert found() == "of-the-variable"
    assert found(written(tmp_path / "option.toml", rig("of-the-option"))) == "of-the-option"


@pytest.mark.parametrize("by", ["option", "variable"])
def test_a_file_that_is_named_but_absent_is_no_demo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    path = str(tmp_path / "nowhere.toml")
    if by == "variable":
        monkeypatch.setenv("CALRIG_CONFIG", path)
    with pytest.raises(SettingsError, match=r"nowhere\.toml: cannot be read \(No such file"):
        load_settings(path if by == "option" else None)


def test_a_folder_is_no_configuration(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read"):
        load_settings(str(tmp_path))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("rig = [", r"end of document"),
        ('[[rig]]\nname = "a\n', r"line 2"),
        ("[[rig]]\n", r"name: Field required"),
        (rig("b", 'colour = "red"'), r"rig 'b', colour: .*not permitted"),
        (rig("b").replace("port", "prot", 1), r"rig 'b', stage, port: Field required"),
        (rig("b", "limits_deg = [10, -10]"), r"rig 'b': limits_deg must be \[lower, upper\]"),
        (rig("b", "limits_deg = [0, nan]"), r"rig 'b', limits_deg, 1: .*finite"),
        (rig("b", "limits_deg = [-inf, 90]"), r"rig 'b', limits_deg, 0: .*finite"),
        (rig("b", "limits_deg = [1, 2, 3]"), r"rig 'b', limits_deg"),
        (rig("b", "reference = { std_deg = -1 }"), r"rig 'b', reference, std_deg: .*greater than 0"),
        (rig("b", "reference = {}"), r"rig 'b', reference: reference needs `std_deg`"),
        (rig("b", 'reference = { std_deg = 1, kind = "odd" }'), r"rig 'b', reference, kind: .*'setting'"),
        (rig("b").replace('"a"', '"a", sign = 2'), r"rig 'b', stage, sign: .*-1 or 1"),
        (rig("b").replace('"a"', '"a", ratio = 0.0'), r"rig 'b', stage, ratio: .*greater than 0"),
        (rig("b").replace('"a"', '"a", axis = 32'), r"rig 'b', stage, axis"),
        (rig("b").replace('"b" }', '"b", baudrate = 0 }'), r"rig 'b', imu, baudrate"),
        (rig("b", "filter = { r_deg2 = 0.0 }"), r"rig 'b', filter, r_deg2"),
        ('[[rig]]\nname = "b"\n', r"rig 'b': a rig needs both `stage` and `imu`"),
        ('[[rig]]\nname = "b/c"\n', r"rig 'b/c', name"),
        ('[[rig]]\nname = ""\n', r"name"),
        (rig("a") + rig("b", "limits_deg = 3"), r"rig 'b', limits_deg"),
        (rig("twin") + rig("twin"), r"two rigs are named 'twin'"),
        ("keep_samples_days = 0", r"keep_samples_days"),
        ('[[limit]]\nname = "x"', r"limit 'x': the limit 'x' asks nothing"),
        ('[[limit]]\nname = "x"\nrms_deg = 0', r"limit 'x', rms_deg: .*greater than 0"),
        ('[[limit]]\nname = "x"\nbias_deg = [1, 0]', r"limit 'x', bias_deg: the lower end 1 is not below"),
        ('[[limit]]\nname = "x"\nrms_deg = 1\n' * 2, r"two limits are named 'x'"),
        (rig("b", 'reference = { std_deg = 1, distribution = "u" }'), r"reference, distribution: .*'normal'"),
        ("rigs = 1", r"rigs: .*not permitted"),
        ("rig = 3", r"rig"),
    ],
)
def test_a_bad_file_is_named_with_rig_and_key(tmp_path: Path, text: str, named: str) -> None:
    with pytest.raises(SettingsError, match=rf"bad\.toml: .*{named}") as refused:
        load_settings(written(tmp_path / "bad.toml", text))
    assert "\n" not in str(refused.value)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_bytes(b"name = '\xff\xfe'")
    with pytest.raises(SettingsError, match=r"bad\.toml: is not UTF-8 text \(byte 8\)"):
        load_settings(str(tmp_path / "bad.toml"))


def test_a_byte_order_mark_is_no_fault(tmp_path: Path) -> None:
    (tmp_path / "bom.toml").write_bytes(b"\xef\xbb\xbf" + rig("marked").encode())
    assert load_settings(str(tmp_path / "bom.toml")).rig[0].name == "marked"


def test_a_simulated_rig_needs_no_ports(tmp_path: Path) -> None:
    text = '[[rig]]\nname = "s"\nsimulated = { preset = "demo", seed = 3 }\n'
    (simulated,) = load_settings(written(tmp_path / "s.toml", text)).rig
    assert simulated.simulated == {"preset": "demo", "seed": 3}


def test_the_store_is_where_it_is_said_to_be(
    places: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, _ = places
    monkeypatch.setattr(platformdirs, "user_data_path", lambda *_args, **_kwargs: tmp_path / "data")
    assert store_url() == f"sqlite:///{tmp_path}/data/calrig.db"
    monkeypatch.setenv("CALRIG_DB", "runs.db")
    assert store_url() == f"sqlite:///{here}/runs.db"
    assert store_url(str(tmp_path / "b.db")) == f"sqlite:///{tmp_path}/b.db"
    assert store_url("sqlite:////var/c.db") == "sqlite:////var/c.db"


@pytest.mark.parametrize(("folder", "file"), [("web", "index.html"), ("migrations", "env.py")])
def test_packed_files_are_found(folder: str, file: str) -> None:
    assert (packed(folder) / file).is_file()


def test_the_names_people_use_for_the_service_stand_above_the_rigs(tmp_path: Path) -> None:
    file = tmp_path / "calrig.toml"
    file.write_text('hosts = ["calrig.lab.example", "10.0.0.7"]\n[[rig]]\nname = "a"\nsimulated = {}\n')
    assert load_settings(str(file)).hosts == ("calrig.lab.example", "10.0.0.7")
    file.write_text('hosts = ["https://calrig.lab.example"]\n')
    with pytest.raises(SettingsError, match="hosts"):
        load_settings(str(file))


LABORATORY = """
[laboratory]
name = "Kalibrierlabor Süd"
logo = "logo.svg"
"""
STAGE = 'reference = { std_deg = 0.1, certificate = "K-1", issued_at = 2025-03-01, due = 2026-03-01%s }'


def test_a_laboratory_and_the_certificates_of_its_standards_are_read_with_what_lies_beside(
    tmp_path: Path,
) -> None:
    (tmp_path / "logo.svg").write_text("<svg/>")
    (tmp_path / "stage.pdf").write_bytes(b"%PDF")
    more = STAGE % ', file = "stage.pdf"' + '\ntime_base = { name = "counter" }\noverdue = "refuse"'
    settings = load_settings(written(tmp_path / "a.toml", LABORATORY + rig("one", more)))
    (bench,) = settings.rig
    assert bench.reference is not None and bench.time_base is not None
    assert (bench.reference.due, bench.overdue) == (date(2026, 3, 1), "refuse")
    assert bench.reference.sha256 == hashlib.sha256(b"%PDF").hexdigest()
    assert settings.laboratory.logo == str(tmp_path / "logo.svg")
    assert settings.laboratory.accreditation is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (LABORATORY + rig("one"), "laboratory: logo logo.svg: is not there"),
        (rig("one", STAGE % ', file = "no.pdf"'), "rig 'one', reference: file no.pdf: cannot be read"),
        (rig("one", STAGE % f', file = "a.toml", sha256 = "{"0" * 64}"'), "not what is stated"),
        (rig("one", "thermometer = { issued_at = 2026-01-02, due = 2026-01-01 }"), "is before issued_at"),
        (rig("one", 'overdue = "ignore"'), "overdue"),
    ],
)
def test_what_a_certificate_could_not_state_is_refused_by_name(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(SettingsError, match=re.escape(says)):
        load_settings(written(tmp_path / "a.toml", text))
