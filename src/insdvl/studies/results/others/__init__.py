"""The process noise of vehicles that are not those of the training, against the best constant."""
