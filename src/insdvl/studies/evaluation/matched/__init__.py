"""The filter that has the true shaping states of the simulated noise: the lower bound."""
