"""The numbers of one vehicle: its state, what changes it, and what it says."""
