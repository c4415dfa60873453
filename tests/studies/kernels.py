"""The calibration's tests under every kernel that this processor has: `python -m tests.studies.kernels`.

No result of calrig may hang on the processor. OpenBLAS and numpy choose their kernels by it, and both can be
told to use those of an older one. Whether it took effect is asked of them; what is not to be had is said and
left out, as is the processor's own, which the README's command uses. With two threads a product is summed in
another order than with that command's one.
Arguments go to pytest.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import NamedTuple


class Kernel(NamedTuple):
    """OpenBLAS's name of a processor, and how numpy's names of the instructions that it lacks begin."""

    name: str
    lacks: tuple[str, ...]


KERNELS = (
    Kernel("SkylakeX", ()),
    Kernel("Haswell", ("AVX512", "X86_V4")),
    Kernel("Nehalem", ("AVX", "FMA", "F16C", "X86_V3", "X86_V4")),
)
THREADS = "2"
PROBE = """
import json, numpy as np, scipy.linalg, threadpoolctl
symmetric = np.arange(40_000.0).reshape(200, 200) % 7.0
np.linalg.svd(symmetric @ symmetric.T), scipy.linalg.eigh(symmetric + symmetric.T)
blas = [pool for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]
simd = np.show_config(mode="dicts")["SIMD Extensions"]
print(json.dumps({
    "kernels": sorted({pool.get("architecture") for pool in blas}),
    "threads": sorted({pool["num_threads"] for pool in blas}),
    "simd": simd.get("found", []),
}))
"""


def main() -> int:
    """Runs the tests under one kernel after the other; 1 where one fails, or where there was none to try."""
    tried, failed = [], []
    own = probe(dict(os.environ))
    instructions = own["simd"]
    for kernel in KERNELS:
        if own["kernels"] == [kernel.name]:
            _say(f"{kernel.name}: this processor's own, by which the README's command has passed or not")
            tried.append(kernel.name)
            continue
        lacks = [one for one in instructions if one.startswith(kernel.lacks)] if kernel.lacks else []
        environment = {
            **os.environ,
            "OPENBLAS_CORETYPE": kernel.name,
            "OPENBLAS_NUM_THREADS": THREADS,
            **({"NPY_DISABLE_CPU_FEATURES": " ".join(lacks)} if lacks else {}),
        }
        took = probe(environment)
        if took["kernels"] != [kernel.name] or set(took["simd"]) & set(lacks):
            why = took["error"] or took["kernels"]
            _say(f"{kernel.name}: left out, since this processor has no such kernel ({why})")
            continue
        without = f", numpy without {' '.join(lacks)}" if lacks else ""
        _say(f"{kernel.name}: threads {took['threads']}{without}")
        tried.append(kernel.name)
        tests = [sys.executable, "-m", "pytest", "-q", "-n", "logical", "tests/calibration", *sys.argv[1:]]
        if subprocess.run(tests, env=environment, check=False).returncode != 0:
            failed.append(kernel.name)
    _say(f"kernels tried: {', '.join(tried) or 'none'}; failed: {', '.join(failed) or 'none'}")
    return 1 if failed or not tried else 0


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def probe(environment: dict[str, str]) -> dict[str, object]:
    """What numpy and scipy compute with in such an environment; an unfit kernel may end the process."""
    done = subprocess.run(
        [sys.executable, "-c", PROBE], env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        return {"kernels": [], "threads": [], "simd": [], "error": said[0]}
    return {**json.loads(done.stdout), "error": None}


if __name__ == "__main__":
    sys.exit(main())
