"""The pictures of the results: ratios of errors with their intervals."""
