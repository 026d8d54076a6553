"""The `ros_insdvl` package: filter, tuner and monitor nodes."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "ros_insdvl"
CONFIG = [str(path) for path in sorted(Path("config").glob("*"))]
LAYOUTS = [str(path) for path in sorted(Path("layouts").glob("*"))]
LAUNCH = [str(path) for path in sorted(Path("launch").glob("*.launch.py"))]

setup(
    name=NAME,
    version="0.1.0",
    description="INS/DVL navigation for ROS 2: the filter, the process noise tuner and the monitor",
    maintainer="ros_insdvl maintainers",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", CONFIG),
        (f"share/{NAME}/launch", LAUNCH),
        (f"share/{NAME}/layouts", LAYOUTS),
    ],
    install_requires=["numpy"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    entry_points={
        "console_scripts": [
            f"{executable} = {NAME}.{executable}:main"
            for executable in ("filter", "monitor", "navigator", "tuner")
        ]
    },
)
