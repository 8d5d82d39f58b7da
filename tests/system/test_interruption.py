"""Ctrl-C and the end of a terminal, from the first moment on."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
from importlib.metadata import distribution

import pytest
from paths import ROOT

from trajeval_ros.ros.lifetime import _endings

FIRST = "trajeval_ros.linear_algebra_threads"  # the first that programs import


def interrupted_at(module: str, program: str, prelude: str = "") -> tuple[int, str]:
    """Start a program, which gets SIGINT while it imports a module; its status and words."""
    code = (
        "import os, signal, sys\n"
        "class CtrlC:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == {module!r}:\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, CtrlC())\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"{prelude}\n"
        "sys.argv[1:] = ['--help']\n"
        f"from trajeval_ros.__main__ import {program}\n"
        f"sys.exit({program}())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    ("module", "program"),
    [
        *itertools.product((FIRST, "click", "numpy"), ("main", "ros_replay")),
        *itertools.product((FIRST, "numpy"), ("ros_evaluator",)),
    ],
)
def test_ctrl_c_in_the_first_second_is_one_line(module: str, program: str) -> None:
    assert interrupted_at(module, program) == (130, "trajeval: interrupted\n")


def test_ctrl_c_while_an_object_is_collected_is_not_lost() -> None:
    code = (
        "import sys, time\n"
        "from trajeval_ros.__main__ import _repeat_interrupt\n"
        "class Collected:\n"
        "    def __del__(self):\n"
        "        raise KeyboardInterrupt\n"
        "sys.unraisablehook = _repeat_interrupt\n"
        "try:\n"
        "    Collected()\n"
        "    time.sleep(600)\n"
        "except KeyboardInterrupt:\n"
        "    sys.exit(7)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (7, "")


@pytest.mark.slow
def test_what_runs_in_the_background_may_ignore_ctrl_c() -> None:
    ignore = "signal.signal(signal.SIGINT, signal.SIG_IGN)"
    assert interrupted_at("click", "main", ignore) == (0, "")


def test_all_programs_begin_by_handling_ctrl_c() -> None:
    programs = distribution("trajeval-ros").entry_points.select(group="console_scripts")
    assert {program.name for program in programs} == {"trajeval", "evaluator", "replay"}
    assert {program.module for program in programs} == {"trajeval_ros.__main__"}


def test_a_missing_package_is_one_sentence() -> None:
    code = (
        "import sys; sys.modules['click'] = None\n"
        "from trajeval_ros.__main__ import main; sys.exit(main())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.startswith("trajeval: ")
    assert done.stderr.count("\n") == 1
    assert "make install" in done.stderr


@pytest.mark.skipif(os.name != "posix", reason="there is no SIGHUP")
def test_a_lost_terminal_asks_for_an_end_unless_nohup_has_it_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup
    try:
        assert signal.SIGHUP in _endings()
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        assert _endings() == [signal.SIGINT, signal.SIGTERM]
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.skipif(os.name != "posix", reason="there are no such terminals")
def test_what_is_said_to_a_terminal_that_is_gone_fails_no_more() -> None:
    code = (
        "import os, sys\n"
        "from trajeval_ros.ros.lifetime import StopSignal\n"
        "os.write(int(sys.argv[1]), b'ready')\n"
        "os.read(0, 1)\n"
        "try:\n"
        "    os.write(1, b'x')\n"
        "except OSError:\n"
        "    StopSignal()()\n"
        "    print('nobody hears', flush=True)\n"
        "    os._exit(7)\n"
    )
    master, slave = os.openpty()
    ready, says_ready = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-c", code, str(says_ready)],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=slave,
        stderr=slave,
        pass_fds=[says_ready],
    ) as process:
        os.close(slave)
        os.close(says_ready)
        assert os.read(ready, 100) == b"ready"
        os.close(ready)
        os.close(master)
        process.communicate(b"x")
    assert process.returncode == 7
