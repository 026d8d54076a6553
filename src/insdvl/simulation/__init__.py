"""A vehicle that never was: truth as functions of time, and what its sensors would have said."""
