"""The rows of the fault matrix that concern processes and networks, flown as real processes."""
