"""`insdvl check`: what is in a recording, whether the filter can use it, and what to set."""
