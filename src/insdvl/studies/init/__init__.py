"""`insdvl init`: a parameter file, filled from a recording."""
