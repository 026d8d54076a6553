"""The targets of the study, set before the measurement."""

from insdvl.studies.evaluation.approaches import BANDS, BANDS_WITH_FACTOR, FACTOR_WITH_R
from insdvl.studies.report.markdown import number
from insdvl.studies.results.others.flights import DEFAULT
from insdvl.studies.results.others.tables import row_of
from insdvl.studies.results.targets import Documents, Target

#: An engineer's limit on what a source of Q may cost against the best constant.
_COST = 1.03


def _on_each_vehicle(row_: str, words: str) -> Target:
    """A target of all vehicles that are not those of the training, which names those that miss."""

    def measured(documents: Documents) -> tuple[str, bool] | None:
        vehicles = documents.get("other-vehicles", {"vehicles": []})["vehicles"]
        if not vehicles:
            return None
        missed = []
        for vehicle in vehicles:
            ratio = row_of(vehicle, row_)["over_best_constant"]
            if ratio is None or ratio[0] > _COST:
                mean = "failed" if ratio is None else number(ratio[0], 3)
                missed.append(f"`{vehicle['vehicle']}` ({mean})")
        text = f"{len(vehicles) - len(missed)} of {len(vehicles)}"
        if missed:
            text += f"; not {', '.join(missed)}"
        return text, not missed

    return Target(
        f"body velocity, {words} / best constant, mean at most {_COST:g} on each vehicle", measured
    )


#: Of the page on vehicles that are not those of the training.
OF_OTHERS = (
    _on_each_vehicle(BANDS_WITH_FACTOR, f"`{BANDS_WITH_FACTOR}`"),
    _on_each_vehicle(FACTOR_WITH_R, f"`{FACTOR_WITH_R}`"),
    _on_each_vehicle(BANDS, f"`{BANDS}`"),
    _on_each_vehicle(DEFAULT, "`default`"),
)
