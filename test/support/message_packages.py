"""Packages of message types, built from their definitions by the generators of the ROS 2 wheels.

There is no ament_cmake among the wheels, so the generated code is compiled here as its CMake files
would: one library for the structures, one for each type support, and one for Python.
"""

import shutil
import subprocess
import sys
import sysconfig
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

PREFIX = Path(sys.prefix)
#: Packages that the definitions are made of.
PARTS = ("std_msgs", "geometry_msgs", "builtin_interfaces")
SUPPORTS = ("c", "fastrtps_c", "introspection_c")


def can_build() -> bool:
    """Whether there are a compiler and Python's headers."""
    header = Path(sysconfig.get_paths()["include"]) / "Python.h"
    return bool(shutil.which("gcc") and shutil.which("g++")) and header.is_file()


def write(folder: Path, definitions: dict[str, str]) -> set[str]:
    """Write each definition, and those of its parts, as ``package/msg/Name.msg``."""
    for kind, text in definitions.items():
        package, _, name = kind.split("/")
        messages = folder / package / "msg"
        messages.mkdir(parents=True, exist_ok=True)
        main, *parts = text.split("=" * 80 + "\n")
        (messages / f"{name}.msg").write_text(main)
        for part in parts:
            head, _, fields = part.partition("\n")
            (messages / f"{head.rpartition('/')[2]}.msg").write_text(fields)
    return {kind.split("/")[0] for kind in definitions}


def build(folder: Path, package: str) -> None:
    """Build a package of `write` into ``folder/site`` and ``folder/lib``."""
    code = folder / "code" / package
    _generate(folder, package, code)
    include, lib, site = folder / "include", folder / "lib", folder / "site" / package
    for path in (include / package, lib, site):
        path.mkdir(parents=True, exist_ok=True)
    for kind in SUPPORTS:
        shutil.copytree(code / kind / "msg", include / package / "msg", dirs_exist_ok=True)
    installed = PREFIX / "include"  # with a folder for each package, which repeats its name
    headers = [include, *installed.iterdir(), installed, np.get_include()]
    headers.append(sysconfig.get_paths()["include"])
    options = ["-O0", "-fPIC", "-shared", "-w", *(f"-I{path}" for path in headers)]
    search = [f"-L{PREFIX / 'lib'}", f"-L{lib}", f"-Wl,-rpath,{PREFIX / 'lib'}"]

    def link(target: Path, sources: Any, *libraries: str) -> None:
        files = [str(path) for path in sources]
        compiler = ["g++", "-std=c++17"] if files[0].endswith(".cpp") else ["gcc"]
        names = [f"-l{name}" for name in libraries]
        command = [*compiler, *options, *files, "-o", str(target), *search, *names]
        subprocess.run(command, check=True, capture_output=True, text=True)

    def parts(of: str) -> list[str]:
        return [f"{part}__{of}" for part in PARTS]

    def library(of: str) -> Path:
        return lib / f"lib{package}__{of}.so"

    structures, support = f"{package}__rosidl_generator_c", "rosidl_typesupport"
    generator = parts("rosidl_generator_c")
    link(
        library("rosidl_generator_c"),
        (code / "c/msg/detail").glob("*.c"),
        "rosidl_runtime_c",
        *generator,
    )
    for kind, suffix in (("introspection_c", "*.c"), ("fastrtps_c", "*.cpp")):
        link(
            library(f"{support}_{kind}"),
            (code / kind / "msg/detail").glob(suffix),
            structures,
            f"{support}_{kind}",
            "rosidl_runtime_c",
            *generator,
            *parts(f"{support}_{kind}"),
        )
    link(
        library(f"{support}_c"),
        (code / "c/msg").glob("*.cpp"),
        *(f"{package}__{support}_{kind}" for kind in ("fastrtps_c", "introspection_c")),
        structures,
        f"{support}_c",
    )
    link(
        library("rosidl_generator_py"),
        (code / "py/msg").glob("*_s.c"),
        structures,
        f"{package}__{support}_c",
        "rosidl_runtime_c",
        *generator,
        *parts("rosidl_generator_py"),
    )
    shutil.copytree(code / "py/msg", site / "msg", dirs_exist_ok=True)
    (site / "__init__.py").touch()
    extension = sysconfig.get_config_var("EXT_SUFFIX")
    for kind in SUPPORTS:
        link(
            site / f"{package}_s__{support}_{kind}{extension}",
            [code / f"py/_{package}_s.ep.{support}_{kind}.c"],
            f"{package}__rosidl_generator_py",
            f"{package}__{support}_{kind}",
            f"{package}__{support}_c",
            structures,
            "rosidl_runtime_c",
        )


def _generate(folder: Path, package: str, code: Path) -> None:
    from rosidl_cli import entry_points as of_command
    from rosidl_cli.command.generate.api import generate

    def once(group_name: str, *, specs: Any = None, strict: bool = False) -> dict[str, Any]:
        """Each entry point once: a wheel here names them twice, which the command refuses."""
        found = {point.name: point for point in entry_points(group=group_name)}
        return {name: found[name] for name in specs or found}

    names = sorted(path.name for path in (folder / package / "msg").glob("*.msg"))
    with mock.patch.object(of_command, "get_entry_points", once):
        generate(
            package_name=package,
            interface_files=[f"{folder / package}:msg/{name}" for name in names],
            include_paths=[str(PREFIX / "share")],
            output_path=code,
            types=["c", "py"],
            typesupports=list(SUPPORTS),
        )
