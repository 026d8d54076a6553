"""The comparison with other IMUs, other rates and noise of the DVL, and outages of the DVL."""
