"""Messages as bytes: their layout in CDR, for those of which there are very many."""
