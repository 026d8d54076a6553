"""The `insdvl` package: the navigation core, without ROS."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "insdvl"
# insdvl/models is a link to the repository's models folder, whose files are installed as data.
MODELS = [
    str(model.relative_to(NAME)) for model in Path(NAME, "models").glob("*") if model.is_file()
]

setup(
    name=NAME,
    version="0.1.0",
    description="INS/DVL navigation without ROS",
    maintainer="ros_insdvl maintainers",
    maintainer_email="maintainers@ros-insdvl.example.com",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={NAME: MODELS},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=[
        "joblib",
        "lz4",
        "matplotlib",
        "numba",
        "numpy",
        "pyyaml",
        "rosbags",
        "scikit-learn",
        "scipy",
        "threadpoolctl",
    ],
    extras_require={
        "dask": ["dask", "distributed"],
        "dnn": ["onnx", "torch"],  # training only
        "onnx": ["onnxruntime"],
        "test": ["hypothesis", "pytest", "python-ins"],
    },
    zip_safe=False,
    entry_points={"console_scripts": ["insdvl = insdvl.cli:main"]},
)
