"""Builds the sketch as the Arduino IDE does, and the harness that runs it; by Debian's own packages."""

from __future__ import annotations

import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from repository import ROOT, SHARED

SKETCH = ROOT / "calrig" / "firmware" / "calrig_imu"
HARNESS = Path(__file__).parent / "harness"
TWIN = SHARED / "twin" / "twin.c"
ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")
CORE, VARIANT = ARDUINO / "cores" / "arduino", ARDUINO / "variants" / "standard"
SIMAVR = Path("/usr/include/simavr/sim_avr.h")
PACKAGES = "gcc-avr avr-libc arduino-core-avr libsimavr-dev libelf-dev gcc libc6-dev"

# platform.txt of the core, but for -Werror: the sketch's own files compile without a warning.
CHIP = ["-Os", "-g", "-flto", "-mmcu=atmega328p", "-DF_CPU=16000000L", "-DARDUINO=10819", "-DARDUINO_AVR_UNO"]
CHIP += ["-DARDUINO_ARCH_AVR", "-ffunction-sections", "-fdata-sections", f"-I{CORE}", f"-I{VARIANT}"]
C = ["avr-gcc", "-c", "-std=gnu11", "-fno-fat-lto-objects", *CHIP]
CPP = ["avr-g++", "-c", "-std=gnu++11", "-fpermissive", "-fno-exceptions", "-fno-threadsafe-statics", *CHIP]
OWN = ["-Wall", "-Wextra", "-Werror"]
FOREIGN = ["-w", "-DDECIMAL_DIG=9"]  # WString.cpp wants it, and avr-libc does not have it


def missing() -> str | None:
    """What keeps the firmware from being run here, and what to install; None if nothing does."""
    wanted = {"avr-gcc": shutil.which("avr-gcc"), "gcc": shutil.which("gcc")}
    wanted |= {"the Arduino core": CORE.is_dir() or None, "libsimavr": SIMAVR.exists() or None}
    lacking = [name for name, found in wanted.items() if not found]
    return f"no {', '.join(lacking)} here: apt-get install {PACKAGES}" if lacking else None


def _run(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stderr}"
    return done.stdout


def _compile(folder: Path, source: Path, extra: list[str]) -> str:
    to = folder / f"{source.name}.o"
    language = ["-x", "c++", "-include", "Arduino.h"] if source.suffix == ".ino" else []
    _run([*(C if source.suffix == ".c" else CPP), *extra, *language, str(source), "-o", str(to)])
    return str(to)


def _objects(folder: Path, sources: list[Path], extra: list[str]) -> list[str]:
    folder.mkdir()
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(lambda source: _compile(folder, source, extra), sources))


def build_core(folder: Path) -> Path:
    """The Arduino core as an archive, of which only what is used gets linked."""
    objects = _objects(folder / "core", sorted(CORE.glob("*.c")) + sorted(CORE.glob("*.cpp")), FOREIGN)
    archive = folder / "core.a"
    _run(["avr-gcc-ar", "rcs", str(archive), *objects])
    return archive


def build_sketch(folder: Path, core: Path, baudrate: int) -> Path:
    """The sketch for one baud rate as an ELF file."""
    sources = [SKETCH / "calrig_imu.ino", *sorted(SKETCH.glob("*.cpp"))]
    objects = _objects(folder / f"sketch-{baudrate}", sources, [*OWN, f"-DCALRIG_BAUDRATE={baudrate}"])
    elf = folder / f"calrig_imu-{baudrate}.elf"
    link = ["avr-gcc", "-Os", "-g", "-flto", "-fuse-linker-plugin", "-Wl,--gc-sections", "-mmcu=atmega328p"]
    _run([*link, "-o", str(elf), *objects, str(core), "-lm"])
    return elf


def build_harness(folder: Path) -> Path:
    """The simulated ATmega328P with its sensor, as a program of this machine."""
    program = folder / "harness"
    sources = [str(source) for source in sorted(HARNESS.glob("*.c"))]
    strict = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", "-isystem", str(SIMAVR.parent)]
    _run(["gcc", *strict, *sources, "-o", str(program), "-lsimavr", "-lelf", "-lm", "-lutil"])
    return program


def build_twin(folder: Path) -> Path:
    """The rig of ../shared/twin, in step with the test's clock."""
    program = folder / "twin"
    options = ["-O2", "-isystem", str(SIMAVR.parent), "-include", str(HARNESS / "twin_in_step.h")]
    _run(["gcc", *options, str(TWIN), "-o", str(program), "-lsimavr", "-lelf", "-lutil", "-lm"])
    return program


def sizes(elf: Path) -> tuple[int, int]:
    """Bytes of flash and of static RAM."""
    text, data, bss = map(int, _run(["avr-size", str(elf)]).splitlines()[1].split()[:3])
    return text + data, data + bss
