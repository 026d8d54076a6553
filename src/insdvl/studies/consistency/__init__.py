"""Is the filter as good as it says? Missions of known truth, many of each, against its sigmas."""
