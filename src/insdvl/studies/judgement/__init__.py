"""Whether a replay can be trusted: what does not fit, and what to set."""
