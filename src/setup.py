"""The `insdvl` package: the navigation core, without ROS."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.install import install

NAME = "insdvl"
# insdvl/models is a link to the repository's models folder, whose files are installed as data.
MODELS = [
    str(model.relative_to(NAME)) for model in Path(NAME, "models").glob("*") if model.is_file()
]


class Install(install):
    """Where colcon installs, also compiles the functions of the filter, for this processor.

    They are kept in the installed package. Whoever names another folder by INSDVL_CACHE_DIR fills
    it with `insdvl warm`.
    """

    def run(self) -> None:
        """Install, then compile."""
        super().run()
        if "COLCON" not in os.environ or "INSDVL_CACHE_DIR" in os.environ:
            return
        modules = Path(self.install_lib).resolve()
        cache = modules / NAME / "__pycache__"
        for old in cache.glob("kernels-*"):
            shutil.rmtree(old)
        environment = os.environ | {"INSDVL_CACHE_DIR": str(cache)}
        command = [sys.executable, "-m", "insdvl.cli", "warm"]
        if subprocess.run(command, cwd=modules, env=environment).returncode:
            print(f"{NAME} is not compiled: its first start does that", file=sys.stderr)


setup(
    cmdclass={"install": Install},
    name=NAME,
    version="0.1.0",
    description="INS/DVL navigation without ROS",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    maintainer="ros_insdvl maintainers",
    license="Apache-2.0",
    license_files=["LICENSE"],
    python_requires=">=3.10",
    packages=find_packages(),
    package_data={NAME: ["py.typed", *MODELS], f"{NAME}.studies.report": ["assets/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    # What runs on a vehicle needs no more than this.
    install_requires=["numba", "numpy", "pyyaml", "scipy"],
    extras_require={
        "bags": ["lz4", "rosbags"],  # insdvl check, init and replay
        "cli": ["rich", "shtab"],  # bars and tables in a terminal; insdvl completion
        "dask": ["dask", "distributed"],  # --backend dask
        "dnn": ["onnx", "torch"],  # insdvl train --preset dnn
        "jobs": ["joblib", "threadpoolctl"],  # insdvl evaluate, train and results
        "onnx": ["onnxruntime"],  # models/*.onnx
        "plot": ["matplotlib"],  # pictures of insdvl evaluate and results
        "report": ["plotly"],  # report.html of insdvl replay and report
        "test": ["hypothesis", "pytest", "python-ins"],
        "train": ["joblib", "scikit-learn", "threadpoolctl"],  # insdvl train
    },
    zip_safe=False,
    entry_points={"console_scripts": ["insdvl = insdvl.cli:main"]},
)
