"""How good a navigation result is: metrics and plots."""
