"""The order of events: samples, time jumps, the fold over them, its output, its state file."""
