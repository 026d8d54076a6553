"""Recordings in files: read, written, checked."""
