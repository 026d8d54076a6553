"""Whole graphs of real processes: the demo, the fault rows of processes, and the soak."""
