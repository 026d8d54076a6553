"""Filters that learn the noise of their DVL, against one that is told it."""
