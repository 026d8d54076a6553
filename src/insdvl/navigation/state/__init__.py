"""The memory of a filter: one record, of which everything that the future depends on is a part."""
