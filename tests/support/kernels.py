"""Run the fast numeric tests with the arithmetic of other CPUs: `make test-kernels`.

OpenBLAS (numpy's and scipy's own copies of it), numpy and glibc choose their code by the CPU, and
each choice rounds in another way. A test that holds for one of them alone is red elsewhere. Here
every machine gets what it would choose, as far as this CPU can run it.

    python tests/support/kernels.py [MACHINE...] [-- OPTIONS OF PYTEST]
    env $(python tests/support/kernels.py --environment MACHINE) COMMAND
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import platform
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

from paths import TESTS

# Everything that is neither slow nor needs ROS is run, so that a new file is run, too. What these
# test is files, processes or pictures, whose numbers no kernel makes; and they take long. Readers
# of text and of transforms do arithmetic, and stay.
LEFT_OUT = (
    "batch/test_cluster.py",
    "batch/test_config.py",
    "batch/test_fingerprints.py",
    "batch/test_manifest.py",
    "batch/test_output.py",
    "batch/test_pools.py",
    "batch/test_report.py",
    "cli/test_outputs.py",
    "formatting/*.py",
    "io/bags/test_[!t]*.py",
    "io/live/*.py",
    "report/test_plots.py",
    "ros/*.py",
    "system/test_action.py",
    "system/test_api.py",
    "system/test_everyday_tasks.py",
    "system/test_install_commands.py",
    "system/test_interruption.py",
    "system/test_messages.py",
    "system/test_packag*.py",
    "system/test_pages.py",
    "system/test_schemas.py",
    "system/test_site.py",
    "system/test_start_up.py",
    "system/test_urls.py",
    "system/test_words.py",
    "viewer/*.py",
)


@dataclass(frozen=True)
class Machine:
    """What libraries choose on a CPU.

    Attributes:
        core: OpenBLAS's name of it, for OPENBLAS_CORETYPE.
        needs: numpy's names of what a CPU needs to run OpenBLAS's code for it.
        without: What numpy must not use: beginnings of the names of its features.
        glibc: What the C library must not use, by its own names.
    """

    core: str
    needs: tuple[str, ...]
    without: tuple[str, ...] = ()
    glibc: tuple[str, ...] = ()


# numpy 2.4 calls AVX2 and FMA3 together X86_V3, and AVX-512 X86_V4.
AVX512 = ("AVX512", "X86_V4")
AVX2 = ("AVX2", "FMA3", "X86_V3")
MACHINES = (
    Machine("Nehalem", ("SSE42",), without=AVX2 + AVX512, glibc=("AVX2", "FMA")),
    Machine("Haswell", ("AVX2", "FMA3"), without=AVX512),
    Machine("Zen", ("AVX2", "FMA3"), without=AVX512),
    Machine("SkylakeX", ("AVX512F", "AVX512CD", "AVX512BW", "AVX512DQ", "AVX512VL")),
)
# Builds of OpenBLAS may lack a core and take another's code for it.
STAND_INS = {"Zen": "Haswell"}


class Effective(TypedDict):
    """What a process uses.

    Attributes:
        cores: OpenBLAS's core, by the name of the library's file: numpy's and scipy's differ.
        features: Of the CPU, as far as numpy may use them.
        dispatched: Those of them that numpy has loops for beyond its baseline.
    """

    cores: dict[str, str]
    features: list[str]
    dispatched: list[str]


def effective() -> Effective:
    """Return what numpy and scipy use in this process."""
    import numpy.linalg  # noqa: F401
    import scipy.linalg  # noqa: F401

    try:
        from numpy._core import _multiarray_umath as numpy_core
    except ImportError:  # numpy 1
        from numpy.core import _multiarray_umath as numpy_core
    features = [name for name, there in numpy_core.__cpu_features__.items() if there]
    return {
        "cores": openblas_cores(),
        "features": features,
        "dispatched": [name for name in numpy_core.__cpu_dispatch__ if name in features],
    }


def openblas_cores() -> dict[str, str]:
    """Return the core that each loaded OpenBLAS uses, by the name of its file."""
    maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    paths = {line.split(maxsplit=5)[-1] for line in maps.splitlines() if "openblas" in line}
    cores: dict[str, str] = {}
    for path in sorted(paths):
        library = ctypes.CDLL(path)
        for prefix in ("scipy_", ""):
            for suffix in ("64_", ""):
                function = getattr(library, f"{prefix}openblas_get_corename{suffix}", None)
                if function is not None:
                    function.restype = ctypes.c_char_p
                    cores.setdefault(Path(path).name, function().decode())
    return cores


def probe(environment: dict[str, str]) -> Effective:
    """Return `effective` of a process of its own."""
    command = [sys.executable, __file__, "--effective"]
    run = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True)
    answer: Effective = json.loads(run.stdout)
    return answer


def environment_of(machine: Machine, dispatched: list[str]) -> dict[str, str]:
    """Return the environment in which libraries take this CPU for another."""
    forbidden = [name for name in dispatched if name.startswith(machine.without)]
    environment = {**os.environ, "OPENBLAS_CORETYPE": machine.core, "OPENBLAS_NUM_THREADS": "1"}
    if forbidden:
        environment["NPY_DISABLE_CPU_FEATURES"] = ",".join(forbidden)
    if machine.glibc:
        names = ",".join(f"-{name}" for name in machine.glibc)
        environment["GLIBC_TUNABLES"] = f"glibc.cpu.hwcaps={names}"
    return environment


def run_as(machine: Machine, native: Effective, options: list[str], *, is_named: bool) -> str:
    """Run the tests as one machine would; return how that ended.

    What this CPU uses by itself is left out unless it is named: all other tests run with it.
    """
    lacking = [name for name in machine.needs if name not in native["features"]]
    if lacking:
        return f"skipped: this CPU lacks {', '.join(lacking)}"
    environment = environment_of(machine, native["dispatched"])
    seen = probe(environment)
    cores, dispatched = seen["cores"], seen["dispatched"]
    if not cores:
        return "FAILED: numpy and scipy here use no OpenBLAS that can be asked"
    if set(cores.values()) == {STAND_INS.get(machine.core)}:
        return f"skipped: this OpenBLAS uses {STAND_INS[machine.core]}'s kernels for it"
    if set(cores.values()) != {machine.core}:
        return f"FAILED: OpenBLAS uses {cores} instead"
    if any(name.startswith(machine.without) for name in dispatched):
        return f"FAILED: numpy still uses {' '.join(dispatched)}"
    if (cores, dispatched) == (native["cores"], native["dispatched"]) and not is_named:
        return "skipped: this CPU uses it by itself, as in all other tests"
    print(f"\n=== {machine.core} ===")
    for library, core in cores.items():
        print(f"{library}: {core}")
    print(f"numpy's dispatch: {' '.join(dispatched) or 'baseline alone'}")
    print(f"glibc without: {' '.join(machine.glibc) or 'nothing'}", flush=True)
    ignored = [f"--ignore-glob={TESTS / pattern}" for pattern in LEFT_OUT]
    begin = time.monotonic()
    pytest = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-n",
        "auto",
        "-m",
        "not slow and not ros and not oracles",
    ]
    run = subprocess.run(
        [*pytest, *ignored, *options], cwd=TESTS.parent, env=environment, check=False
    )
    took = f"{time.monotonic() - begin:.0f} s"
    return f"passed in {took}" if run.returncode == 0 else f"FAILED after {took}"


def main() -> int:
    """Run the tests as every machine, or as those that are named."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    names = [machine.core for machine in MACHINES]
    parser.add_argument("machines", nargs="*", metavar="MACHINE", help=", ".join(names))
    parser.add_argument("--environment", choices=names, help="print its variables, run nothing")
    parser.add_argument("--effective", action="store_true", help=argparse.SUPPRESS)
    given = sys.argv[1:]
    cut = given.index("--") if "--" in given else len(given)
    arguments = parser.parse_args(given[:cut])
    if arguments.effective:
        print(json.dumps(effective()))
        return 0
    unknown = set(arguments.machines) - set(names)
    if unknown:
        parser.error(f"no such machine: {', '.join(sorted(unknown))}")
    if platform.machine() not in ("x86_64", "AMD64") or not Path("/proc/self/maps").exists():
        if arguments.environment:
            return 0
        print(f"skipped: {platform.system()} on {platform.machine()} can't run x86-64's kernels")
        return 0
    native = probe({**os.environ, "NPY_DISABLE_CPU_FEATURES": ""})
    if arguments.environment:
        [machine] = [item for item in MACHINES if item.core == arguments.environment]
        changed = environment_of(machine, native["dispatched"]).items() - os.environ.items()
        print(*(f"{name}={value}" for name, value in sorted(changed)))
        return 0
    chosen = [item for item in MACHINES if item.core in (arguments.machines or names)]
    options, is_named = given[cut + 1 :], bool(arguments.machines)
    ends = {item.core: run_as(item, native, options, is_named=is_named) for item in chosen}
    print("\n=== kernels ===")
    for core, end in ends.items():
        print(f"{core:10}{end}")
    return int(any(end.startswith("FAILED") for end in ends.values()))


if __name__ == "__main__":
    sys.exit(main())
