"""Models of the sensors: what each reads of the truth, and its errors."""
