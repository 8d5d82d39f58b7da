#!/usr/bin/env python3
"""Evaluate topics of a bag from a bare checkout: no ROS, no install.

    evaluate_bag.py BAG --groundtruth TOPIC --estimate TOPIC [--estimate TOPIC ...] [OPTION ...]

All other options are those of `trajeval evaluate`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

try:
    from trajeval_ros.cli.app import main as trajeval
except ModuleNotFoundError as missing:
    print(f"{missing}; run `make install`, then use .venv/bin/python", file=sys.stderr)
    sys.exit(2)


def main() -> int:
    """Turn topics into sources of the bag and hand over to the command line."""
    parser = argparse.ArgumentParser(
        description="Evaluate topics of a bag.",
        epilog="All other options are those of `trajeval evaluate`, after BAG.",
        allow_abbrev=False,
    )
    parser.add_argument("bag", help="a rosbag2 folder, an MCAP file or a ROS 1 bag")
    parser.add_argument("--groundtruth", required=True, metavar="TOPIC")
    parser.add_argument("--estimate", required=True, action="append", metavar="TOPIC")
    known, options = parser.parse_known_args()
    sources = ["--groundtruth", f"{known.bag}:{known.groundtruth}"]
    for topic in known.estimate:
        sources += ["--estimate", f"{known.bag}:{topic}"]
    return trajeval(["evaluate", *sources, *options])


if __name__ == "__main__":
    sys.exit(main())
