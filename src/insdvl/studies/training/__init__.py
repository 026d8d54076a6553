"""How the shipped models are made: data set, ensemble, the `insdvl train` command."""
