"""Weights of the bands of one vehicle: its DVL is the teacher (explanation/dvl-as-teacher.md)."""
