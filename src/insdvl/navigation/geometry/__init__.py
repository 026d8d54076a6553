"""The Earth, rotations and the axes of the conventions."""
