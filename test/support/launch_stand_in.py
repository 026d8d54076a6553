"""A stand-in of launch and launch_ros, which have no wheels: what a launch file would start.

It has what our launch files use, with the names and keywords of the real packages, refuses every
other keyword, and builds command lines as `launch_ros.actions.Node` does.
"""

import importlib.util
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

import yaml
from ament_index_python.packages import get_package_prefix, get_package_share_directory


class LaunchContext:
    """What is known while a launch file runs.

    Attributes:
        launch_configurations: Values of the arguments.
        folder: Of the files that launch writes.
        processes: The processes, in the order in which they start.
    """

    def __init__(self, arguments: Mapping[str, str], folder: Path) -> None:
        self.launch_configurations = dict(arguments)
        self.folder = folder
        self.processes: list[Process] = []


@dataclass
class Process:
    """A process that launch starts.

    Attributes:
        package: Of the executable.
        executable: Its name.
        command: Its command line.
        files: Its parameter files.
        remaps: Its remaps of topics.
        ends_all: Whether everything ends with it.
    """

    package: str
    executable: str
    command: list[str] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    remaps: dict[str, str] = field(default_factory=dict)
    ends_all: bool = False


class Substitution:
    def perform(self, context: LaunchContext) -> str:
        raise NotImplementedError


def text(value: "str | Substitution", context: LaunchContext) -> str:
    if isinstance(value, Substitution):
        return value.perform(context)
    assert isinstance(value, str), value
    return value


class LaunchConfiguration(Substitution):
    def __init__(self, variable_name: str) -> None:
        self.name = variable_name

    def perform(self, context: LaunchContext) -> str:
        return context.launch_configurations[self.name]


class PathJoinSubstitution(Substitution):
    def __init__(self, substitutions: "Iterable[str | Substitution]") -> None:
        self.parts = list(substitutions)

    def perform(self, context: LaunchContext) -> str:
        return str(Path(*(text(part, context) for part in self.parts)))


class FindPackageShare(Substitution):
    def __init__(self, package: str) -> None:
        self.package = package

    def perform(self, context: LaunchContext) -> str:
        return str(get_package_share_directory(self.package))


class ParameterValue:
    def __init__(self, value: Substitution, *, value_type: type) -> None:
        self.value, self.type = value, value_type

    def evaluate(self, context: LaunchContext) -> Any:
        given = self.value.perform(context)
        value = given if self.type is str else yaml.safe_load(given)
        if self.type is float and type(value) is int:
            value = float(value)
        if type(value) is not self.type:
            raise ValueError(f"{given!r} is not of type {self.type.__name__}")
        return value


class IfCondition:
    wanted = "true"

    def __init__(self, predicate_expression: Substitution) -> None:
        self.expression = predicate_expression

    def evaluate(self, context: LaunchContext) -> bool:
        value = self.expression.perform(context)
        assert value in ("true", "false")
        return value == self.wanted


class UnlessCondition(IfCondition):
    wanted = "false"


class LaunchDescription:
    def __init__(self, initial_entities: Iterable[Any]) -> None:
        self.entities = list(initial_entities)

    def execute(self, context: LaunchContext) -> None:
        for entity in self.entities:
            entity.execute(context)


class DeclareLaunchArgument:
    def __init__(
        self,
        name: str,
        *,
        default_value: "str | Substitution | None" = None,
        description: str | None = None,
        choices: list[str] | None = None,
    ) -> None:
        self.name, self.default, self.description = name, default_value, description
        self.choices = choices

    def execute(self, context: LaunchContext) -> None:
        values = context.launch_configurations
        if self.name not in values:
            if self.default is None:
                raise RuntimeError(f'Required launch argument "{self.name}" was not provided.')
            values[self.name] = text(self.default, context)
        if self.choices is not None and values[self.name] not in self.choices:
            raise RuntimeError(f'Argument "{self.name}" provided value is not valid')


class OpaqueFunction:
    def __init__(self, *, function: Callable[[LaunchContext], None]) -> None:
        self.function = function

    def execute(self, context: LaunchContext) -> None:
        assert self.function(context) is None


class Shutdown:
    def __init__(self, *, reason: str) -> None:
        assert reason


class PythonLaunchDescriptionSource:
    def __init__(self, launch_file_path: "str | Substitution") -> None:
        self.path = launch_file_path

    def load(self, context: LaunchContext) -> LaunchDescription:
        return description_of(Path(text(self.path, context)))


class IncludeLaunchDescription:
    def __init__(
        self,
        launch_description_source: PythonLaunchDescriptionSource,
        *,
        launch_arguments: "Iterable[tuple[str, str | Substitution]]",
    ) -> None:
        self.source, self.arguments = launch_description_source, list(launch_arguments)

    def execute(self, context: LaunchContext) -> None:
        description = self.source.load(context)
        declared = {e.name for e in description.entities if isinstance(e, DeclareLaunchArgument)}
        for name, value in self.arguments:
            assert name in declared, f"{name} is not an argument of the included file"
            context.launch_configurations[name] = text(value, context)
        description.execute(context)


class Node:
    def __init__(
        self,
        *,
        package: str,
        executable: str,
        namespace: "str | Substitution",
        output: str,
        parameters: "Iterable[Substitution | dict[str, Any]]" = (),
        remappings: "Iterable[tuple[str, Substitution]]" = (),
        ros_arguments: "Iterable[str | Substitution]" = (),
        condition: IfCondition | None = None,
        on_exit: Shutdown | None = None,
    ) -> None:
        assert output == "screen"
        self.process = Process(package, executable, ends_all=on_exit is not None)
        self.namespace, self.parameters, self.condition = namespace, parameters, condition
        self.remappings, self.ros_arguments = remappings, ros_arguments

    def execute(self, context: LaunchContext) -> None:
        if self.condition is not None and not self.condition.evaluate(context):
            return
        process = self.process
        program = Path(get_package_prefix(process.package), "lib", process.package)
        process.command = [str(program / process.executable), "--ros-args"]
        process.command += [text(argument, context) for argument in self.ros_arguments]
        namespace = text(self.namespace, context)
        process.command += ["-r", f"__ns:=/{namespace.lstrip('/')}"]
        process.files = [self._file(parameters, context) for parameters in self.parameters]
        for path in process.files:
            process.command += ["--params-file", str(path)]
        process.remaps = {name: text(value, context) for name, value in self.remappings}
        for name, value in process.remaps.items():
            process.command += ["-r", f"{name}:={value}"]
        context.processes.append(process)

    @staticmethod
    def _file(parameters: "Substitution | dict[str, Any]", context: LaunchContext) -> Path:
        """A parameter file as it is; a dictionary becomes one for every node of the process."""
        if isinstance(parameters, Substitution):
            return Path(parameters.perform(context))
        values = {
            name: value.evaluate(context) if isinstance(value, ParameterValue) else value
            for name, value in parameters.items()
        }
        path = context.folder / f"launch_params_{len(list(context.folder.iterdir()))}"
        path.write_text(yaml.dump({"/**": {"ros__parameters": values}}))
        return path


_MODULES: dict[str, tuple[type, ...]] = {
    "launch": (LaunchContext, LaunchDescription),
    "launch.actions": (DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, Shutdown),
    "launch.conditions": (IfCondition, UnlessCondition),
    "launch.launch_description_sources": (PythonLaunchDescriptionSource,),
    "launch.substitutions": (LaunchConfiguration, PathJoinSubstitution),
    "launch_ros": (),
    "launch_ros.actions": (Node,),
    "launch_ros.parameter_descriptions": (ParameterValue,),
    "launch_ros.substitutions": (FindPackageShare,),
}


@contextmanager
def _standing_in() -> Iterator[None]:
    modules = {}
    for name, classes in _MODULES.items():
        modules[name] = ModuleType(name)
        for kind in classes:
            setattr(modules[name], kind.__name__, kind)
    with mock.patch.dict(sys.modules, modules):
        yield


def description_of(path: Path) -> LaunchDescription:
    """What a launch file describes."""
    with _standing_in():
        spec = importlib.util.spec_from_file_location(path.stem.replace(".", "_"), path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        description: LaunchDescription = module.generate_launch_description()
    return description


def launched(path: Path, folder: Path, **arguments: str) -> list[Process]:
    """The processes that a launch file starts.

    Args:
        path: The launch file.
        folder: For the files that launch writes.
        arguments: Of the launch file.
    """
    context = LaunchContext(arguments, folder)
    description_of(path).execute(context)
    return context.processes
