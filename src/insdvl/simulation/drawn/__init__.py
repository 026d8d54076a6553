"""Vehicles drawn at random: vibration, waves and errors of the sensors that are not white.

The effective densities of their noise are derived in docs/explanation/effective-noise.md.
"""
