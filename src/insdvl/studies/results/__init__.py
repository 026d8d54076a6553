"""The command `insdvl results`: the studies behind docs/results/, and their pages."""
