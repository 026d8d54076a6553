"""What a window of samples is described by, and the closed forms of its variance."""
