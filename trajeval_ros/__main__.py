"""The programs, from their first moment: `python -m trajeval_ros` is `trajeval`.

Nothing is imported here that takes long: Ctrl-C is heard before everything else is.
"""

import os
import signal
import sys
import threading
from collections.abc import Sequence
from typing import NoReturn

_INTERRUPTED = 130
_AGAIN_S = 0.05


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    # What runs in the background may have been told to ignore it.
    is_heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_heard:
        # An exception would come out of half an import, or be lost in one.
        signal.signal(signal.SIGINT, _leave)
    try:
        from trajeval_ros.cli import app
    except ModuleNotFoundError as missing:
        print(
            f"trajeval: {missing}; in a checkout, use the Python of .venv, which `make install` "
            "makes, or with ROS of .venv-ros, which `make ros-environment` makes",
            file=sys.stderr,
        )
        return 2
    try:
        if is_heard:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            sys.unraisablehook = _hear_again
        return app.main(arguments)
    except KeyboardInterrupt:  # before or after it takes care of that
        _leave()
    finally:
        if is_heard:  # there is nothing left to be put in order
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def ros_replay() -> int:
    """Run `trajeval replay`, under the name that `ros2 run trajeval_ros replay` looks for."""
    return main(["replay", *sys.argv[1:]])


def ros_evaluator() -> int:
    """Run the live evaluator, as `ros2 run trajeval_ros evaluator` does."""
    return main(["evaluator", *sys.argv[1:]])


def _hear_again(dropped: "sys.UnraisableHookArgs") -> None:
    """Repeat a Ctrl-C that came where Python can't raise, as while it collects an object."""
    if isinstance(dropped.exc_value, KeyboardInterrupt):
        again = threading.Timer(_AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
        again.daemon = True
        again.start()
    else:
        sys.__unraisablehook__(dropped)


def _leave(*_: object) -> NoReturn:
    os.write(2, b"trajeval: interrupted\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
