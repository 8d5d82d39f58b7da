#!/usr/bin/env python3
"""Evaluate topics of a bag from a bare checkout: no ROS, no install.

    evaluate_bag.py BAG --groundtruth TOPIC --estimate TOPIC [--estimate TOPIC ...] [OPTION ...]

All other options are those of `trajeval evaluate`.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from trajeval_ros.__main__ import main

if __name__ == "__main__":
    options = [
        f"{sys.argv[1]}:{each}" if before in ("--groundtruth", "--estimate") else each
        for before, each in pairwise(sys.argv[1:])
    ]
    sys.exit(main(["evaluate", *(options or ["--help"])]))
