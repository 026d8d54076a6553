"""Text files in and out of recordings: `insdvl import` and `insdvl export`."""
