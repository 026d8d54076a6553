"""Faults: what may happen to the messages, what is expected then, and what is measured."""
