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

from trajeval_ros.__main__ import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main(["demo", *sys.argv[1:]]))
