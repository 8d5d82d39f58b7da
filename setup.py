"""Build script for both worlds: pip, and colcon (ament_python)."""

import re
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "trajeval_ros"
HERE = Path(__file__).parent


def read_version() -> str:
    """Read the version from the source, so that building needs no numpy."""
    source = (HERE / PACKAGE / "__init__.py").read_text(encoding="utf-8")
    match = re.search(r'^__version__ = "([^"]+)"$', source, re.MULTILINE)
    if match is None:
        raise RuntimeError(f"no __version__ in {PACKAGE}/__init__.py")
    return match.group(1)


def read_long_description() -> str:
    """Read the README, which a package index shows as the project's page."""
    readme = HERE / "README.md"
    return readme.read_text(encoding="utf-8") if readme.is_file() else ""


PLOT = ["matplotlib>=3.8"]
RERUN = [
    "rerun-sdk==0.39.*; python_version < '3.11'",
    "rerun-sdk>=0.41; python_version >= '3.11'",
]
REMOTE = ["universal-pathlib>=0.2.6", "s3fs"]
FOXGLOVE = ["foxglove-schemas-protobuf>=0.3"]
COMPARE = [*PLOT, "jinja2>=3.1", "pyarrow>=14"]
CLUSTER = [*COMPARE, "distributed>=2024.1"]
# Community builds of ROS 2 Jazzy for Linux on x86-64: to develop and test on machines without a
# ROS installation. Users have ROS from its own packages, by package.xml.
ROS = [
    f"ros-jazzy-{name}; sys_platform == 'linux' and platform_machine == 'x86_64'"
    for name in (
        "rclpy[fastrtps]==7.1.6",
        "nav-msgs",
        "geometry-msgs",
        "std-msgs",
        "std-srvs",
        "diagnostic-msgs",
        "rosgraph-msgs",
    )
]
TEST = ["pytest>=8", "pytest-xdist>=3.5", "hypothesis>=6.100"]
STORE = ["moto[s3]>=5", "flask", "flask-cors"]  # an S3 server for tests
BROWSER = ["playwright>=1.50"]  # drives the machine's own Chromium, to test what is shown there
LINT = ["ruff>=0.15", "mypy>=1.15"]

setup(
    name="trajeval-ros",
    version=read_version(),
    description="Evaluate VIO and SLAM trajectories, live and recorded, by one set of definitions",
    long_description=read_long_description(),
    long_description_content_type="text/markdown",
    author="trajeval_ros maintainers",
    author_email="maintainers@trajeval-ros.example",
    maintainer="trajeval_ros maintainers",
    maintainer_email="maintainers@trajeval-ros.example",
    license="Apache-2.0",
    keywords="ros2 slam vio odometry trajectory evaluation ate rpe benchmark",
    classifiers=[
        "Development Status :: 3 - Alpha",
        "Environment :: Console",
        "Intended Audience :: Science/Research",
        "Operating System :: OS Independent",
        "Programming Language :: Python :: 3",
        "Programming Language :: Python :: 3.10",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Programming Language :: Python :: 3.14",
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
    python_requires=">=3.10,<3.15",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={"": ["py.typed", "templates/*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", ["launch/evaluator.launch.py"]),
        (f"share/{PACKAGE}/config", ["config/evaluator.yaml"]),
    ],
    zip_safe=False,
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        "rosbags>=0.11",
        "mcap>=1.2",
        "lz4>=4",
        "zstandard>=0.19",
        "ruamel.yaml>=0.17",
        "typer>=0.17.4",
        "rich>=13",
    ],
    extras_require={
        "plot": PLOT,
        "rerun": RERUN,
        "compare": COMPARE,
        "cluster": CLUSTER,
        "remote": REMOTE,
        "foxglove": FOXGLOVE,
        "ros": ROS,
        "test": TEST,
        "dev": [
            *RERUN,
            *REMOTE,
            *FOXGLOVE,
            *CLUSTER,
            *TEST,
            *BROWSER,
            *STORE,
            *LINT,
        ],
    },
    entry_points={
        "console_scripts": [
            f"trajeval = {PACKAGE}.__main__:main",
            f"evaluator = {PACKAGE}.__main__:ros_evaluator",  # ros2 run trajeval_ros evaluator
            f"replay = {PACKAGE}.__main__:ros_replay",  # ros2 run trajeval_ros replay
        ]
    },
)
