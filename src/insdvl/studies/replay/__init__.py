"""`insdvl replay`: the filter over a recording."""
