"""Weights of the bands of one vehicle, with its DVL as the teacher (docs/explanation/dvl-as-teacher.md)."""
