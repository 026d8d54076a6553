"""The causes of the filter, and the watch that lets them see what happens."""
