#!/usr/bin/env python3
"""Compare many runs from a bare checkout: no ROS, no install.

    compare_runs.py CONFIG.yaml|DIR [OPTION ...]

The options are those of `trajeval compare`.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from trajeval_ros.__main__ import main

# The workers import this file anew.
if __name__ == "__main__":
    sys.exit(main(["compare", *sys.argv[1:]]))
