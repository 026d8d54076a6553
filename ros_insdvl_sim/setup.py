"""The `ros_insdvl_sim` package: simulator, replay and relay nodes, and the demo."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "ros_insdvl_sim"
CONFIG = [str(path) for path in sorted(Path("config").glob("*"))]
LAUNCH = [str(path) for path in sorted(Path("launch").glob("*.launch.py"))]

setup(
    name=NAME,
    version="0.1.0",
    description="INS/DVL navigation for ROS 2: simulator, replay, relay and the demo",
    maintainer="ros_insdvl maintainers",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", CONFIG),
        (f"share/{NAME}/launch", LAUNCH),
    ],
    install_requires=[
        "lz4",
        "matplotlib",
        "numpy",
        "pyyaml",
        "rosbags",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    entry_points={
        "console_scripts": [
            *(f"{node} = {NAME}.{node}:main" for node in ("relay", "replay", "simulator")),
            *(f"{trial} = {NAME}.trials.{trial}:main" for trial in ("demo", "faults", "soak")),
        ]
    },
)
