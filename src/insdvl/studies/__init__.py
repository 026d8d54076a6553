"""What is done on land: replay, training, evaluation, faults, reports."""
