#!/usr/bin/env python3
"""Run `trajeval demo` from a bare checkout: no install.

    live_demo.py [FOLDER]

`make demo` makes a Python that has what it takes.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

ROOT = str(Path(__file__).resolve().parent.parent)
sys.path.insert(0, ROOT)
os.environ["PYTHONPATH"] = ROOT  # for the processes that it starts

try:
    from trajeval_ros.cli.app import main
except ModuleNotFoundError as missing:
    print(f"{missing}; run `make demo`, which has what it takes", file=sys.stderr)
    sys.exit(2)

if __name__ == "__main__":
    sys.exit(main(["demo", *sys.argv[1:]]))
