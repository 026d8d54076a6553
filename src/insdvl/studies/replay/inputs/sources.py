"""Where a replay takes the noise of its sensors from: parameters, the recording, or the tuner."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from insdvl.messages.topics import MEASUREMENT_NOISE, PROCESS_NOISE
from insdvl.navigation.parameters import FilterParameters
from insdvl.parameters.declaration import ParameterError
from insdvl.recordings.parameters import ReplayParameters
from insdvl.recordings.played import Recording
from insdvl.studies.replay.inputs.learning import Learned, LearnedOfDvl
from insdvl.tuner.models import load_model
from insdvl.tuner.parameters import TunerParameters

#: Parameters of the tuner that say what learns Q.
LEARNERS = ("model", "estimator")


@dataclass(frozen=True)
class Configuration:
    """With what a recording is navigated.

    Attributes:
        filter: Parameters of the filter.
        tuner: Parameters of the tuner.
        replay: Parameters of the replay.
        named: Those of the `LEARNERS` that the command line itself sets. Who names one wants it:
            it is used, or the replay is refused.
        text: Where they are from.
        warnings: What of the files has no effect.
    """

    filter: FilterParameters
    tuner: TunerParameters
    replay: ReplayParameters
    named: Mapping[str, str]
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
    """Refuse a model or an estimator that the command line names, and that nothing would use.

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

    The vehicle is that of the filter.
    """
    filter_, tuner = configuration.filter, configuration.tuner
    source = filter_.dvl.noise_source
    if source == "nominal":
        return recording, source
    if MEASUREMENT_NOISE in recording.topics:
        return recording, f"{source}, recorded"
    if not (tuner.measurement_noise and tuner.enabled):
        return recording, source
    return LearnedOfDvl(recording, tuner.of_vehicle(filter_)), f"{source}, learned by the tuner"


def _warn(text: str) -> None:
    print(f"insdvl replay: WARN {text}", file=sys.stderr)
