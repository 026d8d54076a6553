"""What the studies on recordings are held against: hand-set noise and targets."""
