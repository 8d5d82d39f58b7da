"""What pip and colcon (ament_python) both build from; the rest is in pyproject.toml.

colcon runs this file with its distribution's setuptools: 59 on Humble doesn't read pyproject.toml,
and 68 on Jazzy refuses a licence expression there. So name, version, licence, Python's versions
and programs are here.
"""

import re
from pathlib import Path

import setuptools

PACKAGE = "trajeval_ros"
HERE = Path(__file__).parent
# The first version of setuptools that knows licence expressions (PEP 639).
_SINCE = 77


def read_version() -> str:
    """Read the version from the source, so that building needs no numpy."""
    source = (HERE / PACKAGE / "__init__.py").read_text(encoding="utf-8")
    match = re.search(r'^__version__ = "([^"]+)"$', source, re.MULTILINE)
    if match is None:
        raise RuntimeError(f"no __version__ in {PACKAGE}/__init__.py")
    return match.group(1)


knows_expressions = int(setuptools.__version__.split(".")[0]) >= _SINCE

setuptools.setup(
    name="trajeval-ros",
    version=read_version(),
    **{"license_expression" if knows_expressions else "license": "Apache-2.0"},
    # Here it stays a text: colcon can't read the object that setuptools makes of the table's.
    python_requires=">=3.10,<3.15",
    packages=[
        *setuptools.find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
        f"{PACKAGE}.report.templates",  # has no modules; setuptools warns if it is not listed
    ],
    package_data={"": ["py.typed", "*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (
            f"share/{PACKAGE}/launch",
            ["launch/evaluator.launch.py", "launch/three_robots.launch.py"],
        ),
        (
            f"share/{PACKAGE}/config",
            [
                "config/diagnostic_aggregator.yaml",
                "config/evaluator.yaml",
                "config/evaluator.rviz",
                "config/foxglove.json",
                "config/plotjuggler.xml",
            ],
        ),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"trajeval = {PACKAGE}.__main__:main",
            f"evaluator = {PACKAGE}.__main__:ros_evaluator",  # ros2 run trajeval_ros evaluator
            f"replay = {PACKAGE}.__main__:ros_replay",  # ros2 run trajeval_ros replay
        ]
    },
)
