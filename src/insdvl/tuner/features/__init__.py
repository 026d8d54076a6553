"""Features of a window of samples, and closed-form estimators of its variance."""
