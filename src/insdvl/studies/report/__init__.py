"""Pages, tables and plots that are generated."""
