"""The programs, from their first moment: `python -m trajeval_ros` is `trajeval`.

Nothing is imported here that takes long: Ctrl-C is handled first, and the number of threads of
linear algebra is set before numpy is imported.
"""

from __future__ import annotations

import gc
import os
import signal
import sys

from trajeval_ros import __version__

TYPE_CHECKING = False  # as in `trajeval_ros`
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import NoReturn, TypeAlias

    Program: TypeAlias = Callable[[Sequence[str]], int]

_INTERRUPTED = 130
_REPEAT_AFTER_S = 0.05


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    if words == ["--version"]:
        # Scripts call it often: it does not import the command line's libraries.
        print(f"trajeval_ros {__version__}")
        return 0
    return _run(_command_line, words)


def ros_replay() -> int:
    """Run `trajeval replay`, under the name that `ros2 run trajeval_ros replay` looks for."""
    return _run(_command_line, ["replay", *sys.argv[1:]])


def ros_evaluator() -> int:
    """Run the live evaluator, as `ros2 run trajeval_ros evaluator` does."""
    return _run(_evaluator, sys.argv[1:])


def _command_line(words: Sequence[str]) -> Program:
    from trajeval_ros.cli import app

    app.load(words)
    return app.main


def _evaluator(_words: Sequence[str]) -> Program:
    from trajeval_ros.cli.programs import evaluator_main

    return evaluator_main


def _run(load: Callable[[Sequence[str]], Program], words: Sequence[str]) -> int:
    # A program in the background may ignore it.
    handles_interrupts = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if handles_interrupts:
        # An exception would come out of half an import, or be lost in one.
        signal.signal(signal.SIGINT, _leave)
    from trajeval_ros.linear_algebra_threads import take_one_thread

    take_one_thread()
    # Imports leave nothing to collect. Their objects stay, and are never searched for garbage.
    gc.disable()
    try:
        program = load(words)
    except ModuleNotFoundError as missing:
        print(
            f"trajeval: {missing}; install the dependencies with pip install trajeval-ros. In a "
            "checkout, run `make install` and use the Python of .venv, or with ROS, run `make "
            "ros-environment` and use .venv-ros",
            file=sys.stderr,
        )
        return 2
    gc.freeze()
    gc.enable()
    try:
        if handles_interrupts:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            sys.unraisablehook = _repeat_interrupt
        return program(words)
    except KeyboardInterrupt:  # before or after the program handles it
        _leave()
    finally:
        if handles_interrupts:  # nothing is left to clean up
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def _repeat_interrupt(dropped: sys.UnraisableHookArgs) -> None:
    """Repeat a Ctrl-C that came where Python can't raise, as in the finaliser of an object."""
    import threading

    if isinstance(dropped.exc_value, KeyboardInterrupt):
        again = threading.Timer(_REPEAT_AFTER_S, os.kill, (os.getpid(), signal.SIGINT))
        again.daemon = True
        again.start()
    else:
        sys.__unraisablehook__(dropped)


def _leave(*_: object) -> NoReturn:
    os.write(2, b"trajeval: interrupted\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
