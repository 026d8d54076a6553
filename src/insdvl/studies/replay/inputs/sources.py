"""Where a replay takes the noise of its sensors from: parameters, the recording, or the tuner."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from insdvl.messages.topics import MEASUREMENT_NOISE, PROCESS_NOISE
from insdvl.navigation.measurement_noise.source import NOMINAL, ORACLE
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError
from insdvl.recordings.parameters import ReplayParameters
from insdvl.recordings.played import Recording
from insdvl.studies.replay.inputs.learning import Learned, LearnedOfDvl
from insdvl.tuner.models import load_model
from insdvl.tuner.parameters import TunerParameters

#: Parameters of the tuner that say what learns Q.
LEARNERS = ("model", "estimator")
#: Values of dvl.noise_source with which the R that the tuner learns is not used.
_NOT_LEARNED = (NOMINAL, ORACLE)


@dataclass(frozen=True)
class Configuration:
    """With what a recording is navigated.

    Attributes:
        filter: Parameters of the filter.
        tuner: Parameters of the tuner.
        replay: Parameters of the replay.
        named: Those of the `LEARNERS` that the command line itself sets. Who names one wants it:
            it is used, or the replay is refused.
        learns_dvl_noise: Whether the command line itself sets ``measurement_noise``; the same
            holds of it.
        text: Where they are from.
        warnings: What of the files has no effect.
    """

    filter: FilterParameters
    tuner: TunerParameters
    replay: ReplayParameters
    named: Mapping[str, str]
    learns_dvl_noise: bool
    text: str
    warnings: tuple[str, ...]

    @property
    def learner(self) -> str:
        """Which of the `LEARNERS` is used where Q is learned: the estimator, if there is one."""
        return "estimator" if self.tuner.estimator else "model"


def named_of(told: Mapping[str, Any]) -> dict[str, str]:
    """Those of the `LEARNERS` among parameters that are set; an empty estimator is none."""
    return {
        name: str(told[name])
        for name in LEARNERS
        if name in told and (told[name] or name == "model")
    }


def check_named(configurations: Sequence[Configuration]) -> None:
    """Refuse what the command line itself sets to learn noise, and that nothing would use.

    It may be meant for one of several configurations that are compared.

    Raises:
        ParameterError: It is not used in any of them.
        ModelError: There is no such model.
    """
    used = {(c.learner, getattr(c.tuner, c.learner)) for c in configurations if _learns(c)}
    for one in configurations:
        for name, value in one.named.items():
            if name == "model":
                load_model(value)
            if (name, value) not in used:
                raise ParameterError(_not_used(one, name, value))
    sources = [c.filter.dvl.noise_source for c in configurations if c.learns_dvl_noise]
    if sources and all(source in _NOT_LEARNED for source in sources):
        raise ParameterError(
            "parameter 'measurement_noise' of insdvl_tuner is set to True but would not be used: "
            f"dvl.noise_source is {sources[0]!r}; add --set dvl.noise_source=adaptive, or leave "
            "measurement_noise out"
        )


def _learns(configuration: Configuration) -> bool:
    return configuration.filter.process_noise.source == "external"


def _not_used(configuration: Configuration, name: str, value: str) -> str:
    text = f"parameter {name!r} of insdvl_tuner is set to {value!r} but would not be used: "
    if _learns(configuration):
        return text + f"estimator {configuration.tuner.estimator!r} takes its place; set only one"
    source = configuration.filter.process_noise.source
    return (
        f"{text}process_noise.source is {source!r}; add --set process_noise.source=external, or "
        f"leave {name} out"
    )


def with_process_noise(recording: Recording, configuration: Configuration) -> tuple[Recording, str]:
    """The recording with the Q that the tuner learns, where that is asked for; and its source.

    A recording that has Q keeps it, as the vehicle had it, unless the command line names what
    learns it.
    """
    filter_, tuner = configuration.filter, configuration.tuner
    source = filter_.process_noise.source
    learner = configuration.learner
    name = getattr(tuner, learner)
    is_recorded = PROCESS_NOISE in recording.topics
    if source == "external" and is_recorded and learner not in configuration.named:
        if name != getattr(TunerParameters(), learner):
            _warn(
                f"the recording has {PROCESS_NOISE}, which is used; the {learner} {name!r} of the "
                f"parameter files is not: --set {learner}={name} uses it"
            )
        return recording, "external, recorded"
    if source != "external":
        return recording, source
    if not tuner.enabled:
        has = "is not to be taken from the recording" if is_recorded else "is not in the recording"
        raise ParameterError(
            f"process_noise.source is 'external', but the process noise {has} and the tuner is "
            "not enabled: set insdvl_tuner:enabled=true"
        )
    if 1.0 / tuner.rate > filter_.q_timeout:
        raise ParameterError(
            f"parameter 'rate' of insdvl_tuner must be at least {1 / filter_.q_timeout:g} "
            f"Hz, got {tuner.rate!r}: q_timeout of insdvl_filter is {filter_.q_timeout:g} s"
        )
    instead = ", in place of the recorded" if is_recorded else ""
    return Learned(recording, tuner), f"external, learned by {name}{instead}"


def with_measurement_noise(
    recording: Recording, configuration: Configuration
) -> tuple[Recording, str]:
    """The recording with the R that the tuner learns, where that is asked for; and its source.

    The vehicle is that of the filter. A recording that has R keeps it, unless the command line
    itself asks the tuner for it.
    """
    filter_, tuner = configuration.filter, configuration.tuner
    source = filter_.dvl.noise_source
    if source in _NOT_LEARNED:
        return recording, source
    is_recorded = MEASUREMENT_NOISE in recording.topics
    if is_recorded and not configuration.learns_dvl_noise:
        return recording, f"{source}, recorded"
    if not tuner.measurement_noise:
        return recording, source
    if not tuner.enabled:
        if configuration.learns_dvl_noise:
            raise ParameterError(
                "parameter 'measurement_noise' of insdvl_tuner is set to True, but the tuner is "
                "not enabled: set insdvl_tuner:enabled=true"
            )
        return recording, source
    instead = ", in place of the recorded" if is_recorded else ""
    learned = LearnedOfDvl(recording, tuner.of_vehicle(filter_))
    return learned, f"{source}, learned by the tuner{instead}"


def _warn(text: str) -> None:
    print(f"insdvl replay: WARN {text}", file=sys.stderr)
