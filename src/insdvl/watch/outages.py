"""How long a sensor may be unheard, for the filter's status and for the verdict of a replay."""

#: Time without a used measurement that is worth a warning [s].
OUTAGE = 5.0
#: Time after which the position is useless [s].
LOST = 60.0
