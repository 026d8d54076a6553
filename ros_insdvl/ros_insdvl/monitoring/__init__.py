"""What the monitor knows of filters: their topics, and the numbers that its table shows."""
