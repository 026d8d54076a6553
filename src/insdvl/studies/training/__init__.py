"""How the shipped models are trained: data set, ensemble, network, the command `insdvl train`."""
